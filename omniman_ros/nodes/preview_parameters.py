"""Parameters that nodes with streams of references share."""

from dataclasses import dataclass

from omniman_ros.core.parameters import parameter
from omniman_ros.core.validated import Validated


@dataclass(frozen=True, kw_only=True)
class RestartParameters(Validated):
    """When a stream of references begins anew after it has lost control."""

    restart: float = parameter(
        1.2,
        "Silence after control was lost; longer than the controller's timeouts.cancelled.",
        unit="s",
        low=0.05,
        high=60,
    )


@dataclass(frozen=True, kw_only=True)
class PreviewParameters(RestartParameters):
    """Parameters of a stream of previews."""

    horizon: float = parameter(
        0.4,
        "Length of each preview; at its end the robot ramps to rest.",
        unit="s",
        low=0.1,
        high=5,
        read_only=True,
    )


@dataclass(frozen=True, kw_only=True)
class PeriodicPreviewParameters(PreviewParameters):
    """Parameters of previews with a period that can be set.

    Raises:
        ParameterError: A preview would end before the next but one is due.
    """

    period: float = parameter(
        0.04, "Period of the previews.", unit="s", low=0.008, high=1, read_only=True
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if 2.0 * self.period > self.horizon:
            raise self._refusal("period", f"must be <= half the horizon {self.horizon:g} s")
