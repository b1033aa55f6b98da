"""What an action needs of an interface that drives trajectories."""

from typing import Protocol

from trajectory_msgs.msg import JointTrajectory

from omniman_ros.core.arrays import Array


class TrajectoryExecutor(Protocol):
    """An interface that drives trajectories, whose motions are identified by numbers."""

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the n axes."""

    def send(self, message: JointTrajectory) -> int:
        """Accept a trajectory, or raise InputError; return the number of its motion."""

    def outcome(self, motion: int) -> str | None:
        """Return why a motion ended: empty if it arrived; None while it goes on."""

    def cancel(self, motion: int) -> None:
        """Bring a motion to rest on its path, unless it has ended already."""

    def desired(self) -> tuple[Array, Array, Array] | None:
        """Return the reference positions, velocities and accelerations (n,), if there are any."""

    def actual(self) -> tuple[Array, Array] | None:
        """Return measured positions and velocities (n,), if they are known."""
