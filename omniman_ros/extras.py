"""Optional libraries: whether they are installed, and what to install if they are not.

Check this before importing a module that needs the library.
"""

import sys
import sysconfig
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path


@dataclass(frozen=True)
class Extra:
    """A feature that needs libraries beyond ROS and numpy."""

    modules: tuple[str, ...]  #: Modules that must be importable
    need: str  #: What the feature is and which libraries it needs, for error messages
    packages: str  #: What pip installs for it

    @property
    def is_available(self) -> bool:
        """Whether all the modules are installed."""
        return all(find_spec(module) is not None for module in self.modules)

    @property
    def hint(self) -> str:
        """What the feature needs and how to install it, for error messages."""
        return f"{self.need}: {pip_install()} {self.packages}"


def pip_install() -> str:
    """Return the command with which pip installs packages for this interpreter.

    Debian and Ubuntu refuse packages of pip for the system's interpreter unless they are asked
    explicitly (PEP 668).
    """
    is_managed = Path(sysconfig.get_path("stdlib"), "EXTERNALLY-MANAGED").is_file()
    is_system = sys.prefix == sys.base_prefix
    return "pip install --break-system-packages" if is_managed and is_system else "pip install"


CLUSTER = Extra(("distributed",), "a sweep on a cluster needs dask", "distributed")
CAN = Extra(
    ("can", "canopen"), "drives on a CAN bus need python-can and canopen", "python-can canopen"
)
FILM = Extra(("PIL",), "films need Pillow", "pillow")
PLANNING = Extra(("casadi",), "the planner needs casadi", "casadi")
RECORDING = Extra(("rosbags",), "recordings need rosbags", "rosbags")
ROS = Extra(
    ("rclpy",),
    "ROS 2 is not installed here. On a ROS 2 machine: source /opt/ros/jazzy/setup.bash first. "
    "Elsewhere",
    "'omniman_ros[ros]'",
)
TRACKING = Extra(("scipy",), "the obstacle tracker needs scipy", "scipy")
VIEWER = Extra(("viser",), "the viewer needs viser", "'viser==1.1.*' websockets")
WORLD = Extra(("mujoco",), "the physics world needs mujoco-core", "'mujoco-core==4.*'")
