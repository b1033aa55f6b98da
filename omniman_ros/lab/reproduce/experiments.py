"""Table of the experiments of `omniman reproduce`."""

from dataclasses import dataclass

_CASES = "omniman_ros.lab.reproduce.cases"


@dataclass(frozen=True)
class Experiment:
    """An experiment.

    Attributes:
        name: Name on the command line; the result is written to `reproduce_NAME.json`.
        module: Module whose function `run(args)` runs the experiment; it is imported only then.
        robot: Robot that is used if the command line names none.
        minutes: Approximate duration at the default size on two idle cores [min].
        caption: Caption of the picture.
        in_world: Whether it can be driven in the physics world as well, `--world`.
    """

    name: str
    module: str
    robot: str
    minutes: int
    caption: str
    in_world: bool = False

    @property
    def result_name(self) -> str:
        """Name of the results, without a suffix."""
        return result_name(self.name)


def result_name(experiment: str, wheels: str | None = None) -> str:
    """Return the name of the results of an experiment, without a suffix.

    Args:
        experiment: Name of the experiment.
        wheels: Kind of wheels in the physics world; None for the plant.
    """
    return f"reproduce_{experiment}_{wheels}" if wheels else f"reproduce_{experiment}"


EXPERIMENTS = {
    experiment.name: experiment
    for experiment in (
        Experiment(
            "coupling",
            "omniman_ros.lab.reproduce.coupling",
            "omniman",
            9,
            "Coupling error along the path of CCTA 2017, Fig. 7, and what gain and delay do to it",
            in_world=True,
        ),
        Experiment(
            "odometry",
            "omniman_ros.lab.reproduce.odometry",
            "omniman",
            1,
            "Odometry after the path of CCTA 2017, Fig. 7, by the wheels and with imu",
            in_world=True,
        ),
        Experiment(
            "tool_path",
            "omniman_ros.lab.reproduce.tool_path",
            "omniman",
            1,
            "Error of the tool on its path, with and without correction by the arm",
            in_world=True,
        ),
        Experiment("free", _CASES, "ig42", 1, "Free movement, MPC 2021, 4.1", in_world=True),
        Experiment(
            "free_paper",
            "omniman_ros.lab.reproduce.free_paper",
            "ig42",
            1,
            "Free movement with the paper's own problem, MPC 2021, 4.1: what its weights decide",
        ),
        Experiment("corridor", _CASES, "ig42", 1, "Narrow corridor, MPC 2021, 4.2", in_world=True),
        Experiment(
            "moving",
            _CASES,
            "ig42",
            1,
            "Moving obstacles, MPC 2021, 4.3 (the film is beside this page)",
            in_world=True,
        ),
        Experiment(
            "handover",
            "omniman_ros.lab.reproduce.handover",
            "omniman",
            2,
            "Two robots side by side in motion, as for handing over a load, MPC 2021, 5",
            in_world=True,
        ),
        Experiment(
            "workshop", _CASES, "ig42", 1, "A dead end and three doors, with a map", in_world=True
        ),
        Experiment(
            "scenes",
            "omniman_ros.lab.reproduce.scenes",
            "ig42",
            7,
            "Random scenes: failed drives first, then those with the smallest gaps",
            in_world=True,
        ),
    )
}
"""Experiments by name, in the order in which `all` runs and reports them."""
ARM_ROBOT = "omniman"
"""Robot of `scenes --arm`, unless another one is chosen."""
SCENES_OPTIONS = ("count", "seeds", "jobs", "solve_time")
"""Command-line options that apply to the experiment `scenes` only."""
