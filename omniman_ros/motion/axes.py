"""Axes of the whole robot: their names, their number and their order in arrays.

The axes are odom_x, odom_y [m] and odom_t [rad], the platform's pose in odom, and then the joints
of the arm [rad].
"""

from omniman_ros.core.arm_model import JOINTS

PLATFORM_AXES = ("odom_x", "odom_y", "odom_t")  #: Names of the platform's axes in trajectories
#: Name of MoveIt's planar joint between odom and base_link, which has the platform's axes
PLANAR_JOINT = "platform"
#: Names of the platform's axes as variables of that joint
PLANAR_VARIABLES = tuple(f"{PLANAR_JOINT}/{label}" for label in ("x", "y", "theta"))
AXES = len(PLATFORM_AXES) + JOINTS  #: Number of axes of the whole body
#: Columns of the platform's axes in arrays (..., AXES)
PLATFORM_COLUMNS = slice(None, len(PLATFORM_AXES))
JOINT_COLUMNS = slice(len(PLATFORM_AXES), None)  #: Columns of the arm's joints in such arrays
HEADING_COLUMN = PLATFORM_AXES.index("odom_t")  #: Column of the platform's heading in such arrays
