"""What a script needs of the ROS side; importing it needs rclpy and rotcal_msgs."""

from rotcal_ros.nodes.calibrator import Calibrator, CalibratorError, GoalRefusedError
from rotcal_ros.nodes.goal_reports import Feedback, Outcome

__all__ = ["Calibrator", "CalibratorError", "Feedback", "GoalRefusedError", "Outcome"]
