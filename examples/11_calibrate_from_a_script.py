"""Calibrate a cell from a script over ROS 2: start, watch, answer for a person, use the result.

First start a cell: ``ros2 launch rotcal_ros cell.launch.py simulated:=true``; the script takes the
configuration as an argument.
"""

import sys

import rotcal_ros as rc

configuration = sys.argv[1] if len(sys.argv) > 1 else ""  # none: the planner's parameters
with rc.ros.Calibrator("/cell") as calibrator:  # leaving the block cancels what still runs
    calibrator.wait_until_ready()
    calibrator.start(configuration)
    while not calibrator.is_done(timeout_s=1.0):
        feedback = calibrator.feedback()
        if feedback is not None:
            print(f"step {feedback.step} of {feedback.total}: {feedback.activity}", flush=True)
            if feedback.instruction:
                input("Enter when this is done: ")
                calibrator.resume()
    outcome = calibrator.result()

print("bag:", outcome.bag_folder)
result = outcome.load()  # raises with the reason when there is none
print(f"verdict {result.verdict_line}, {result.n_observations} observations")
if len(sys.argv) > 1:  # a simulated cell reports its truth
    truth = rc.simulated_truth(rc.read_configuration(configuration))["ECC"]
    ratio = abs(result.deviations["ECC"] - truth)[1:] / result.std["ECC"][1:]
    print(f"largest error against the truth: {ratio.max():.2f} standard uncertainties")
