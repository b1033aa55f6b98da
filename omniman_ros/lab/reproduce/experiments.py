"""The experiments of `omniman reproduce`, as a table."""

from dataclasses import dataclass

_CASES = "omniman_ros.lab.reproduce.cases"


@dataclass(frozen=True)
class Experiment:
    """An experiment.

    Attributes:
        name: Name on the command line; its result is `reproduce_NAME.json`.
        module: Module whose `run(args)` is the experiment; it is imported when it runs.
        robot: Robot that drives where none is named.
        minutes: Duration of the default size on two free cores [min].
        caption: Caption of its picture.
    """

    name: str
    module: str
    robot: str
    minutes: int
    caption: str

    @property
    def result_name(self) -> str:
        """Name of its results, without a suffix."""
        return f"reproduce_{self.name}"


EXPERIMENTS = {
    experiment.name: experiment
    for experiment in (
        Experiment(
            "coupling",
            "omniman_ros.lab.reproduce.coupling",
            "omniman",
            5,
            "Coupling error along the path of CCTA 2017, Fig. 7, and what the gain does",
        ),
        Experiment(
            "tool_path",
            "omniman_ros.lab.reproduce.tool_path",
            "omniman",
            1,
            "Tool on its path, platform and arm in step: with the arm's correction, without",
        ),
        Experiment("free", _CASES, "ig42", 1, "Free movement, MPC 2021, 4.1"),
        Experiment("corridor", _CASES, "ig42", 1, "Narrow corridor, MPC 2021, 4.2"),
        Experiment(
            "moving",
            _CASES,
            "ig42",
            1,
            "Moving obstacles, MPC 2021, 4.3 (the film is beside this page)",
        ),
        Experiment("workshop", _CASES, "ig42", 1, "A dead end and three doors, with a map"),
        Experiment(
            "scenes",
            "omniman_ros.lab.reproduce.scenes",
            "ig42",
            7,
            "Random scenes: those that failed, then those that came closest to something",
        ),
    )
}
"""The experiments by name, in the order in which they are run and reported."""
SCENES_OPTIONS = ("count", "seeds", "jobs", "solve_time")
"""Options of the command line that only the experiment `scenes` has."""
