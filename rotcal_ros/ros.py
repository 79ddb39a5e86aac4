"""What a script needs of the ROS side; importing it needs rclpy and rotcal_msgs.

It works with a live graph of nodes only: examples/11_calibrate_from_a_script.py shows how.
"""

from rotcal_ros.nodes.client.calibrator import (
    Calibrator,
    CalibratorError,
    Feedback,
    GoalRefusedError,
    Outcome,
)

__all__ = ["Calibrator", "CalibratorError", "Feedback", "GoalRefusedError", "Outcome"]
