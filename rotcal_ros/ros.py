"""What a script needs of the ROS side; importing it needs rclpy and rotcal_msgs."""

from rotcal_ros.nodes.calibrator import (
    Calibrator,
    CalibratorError,
    Feedback,
    GoalRefusedError,
    Outcome,
)

__all__ = ["Calibrator", "CalibratorError", "Feedback", "GoalRefusedError", "Outcome"]
