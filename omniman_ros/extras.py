"""Optional libraries: whether they are installed, and what to install if they are not.

Check this before importing a module that needs the library.
"""

from dataclasses import dataclass
from importlib.util import find_spec


@dataclass(frozen=True)
class Extra:
    """A feature that needs libraries beyond ROS and numpy.

    Attributes:
        modules: Modules that must be importable.
        hint: What the feature is and how to install it, for error messages.
    """

    modules: tuple[str, ...]
    hint: str

    @property
    def is_available(self) -> bool:
        """Whether all the modules are installed."""
        return all(find_spec(module) is not None for module in self.modules)


CAN = Extra(
    ("can", "canopen"),
    "drives on a CAN bus need python-can and canopen: pip install python-can canopen",
)
PLANNING = Extra(("casadi",), "the planner needs casadi: pip install casadi")
RECORDING = Extra(
    ("rosbags",),
    "recordings need rosbags: pip install 'omniman_ros[record]', or pip install rosbags",
)
VIEWER = Extra(("viser",), "the viewer needs viser: pip install 'viser==1.1.*' websockets")
WORLD = Extra(
    ("mujoco",),
    "the physics world needs mujoco-core: pip install 'omniman_ros[world]', or "
    "pip install 'mujoco-core==4.*'",
)
