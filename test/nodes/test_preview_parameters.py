import pytest

from omniman_ros.core.errors import ParameterError
from omniman_ros.core.parameters import build
from omniman_ros.nodes.path_interpolator.parameters import PathInterpolatorParameters
from omniman_ros.nodes.station_keeper_parameters import StationKeeperParameters
from test import robots


@pytest.mark.parametrize("kind", [PathInterpolatorParameters, StationKeeperParameters])
def test_a_preview_covers_two_periods(kind):
    values = robots.values("ig42")
    assert build(kind, values | {"period": 0.15, "horizon": 0.3}).period == 0.15
    with pytest.raises(ParameterError, match=r"period.*half the horizon 0\.3 s"):
        build(kind, values | {"period": 0.151, "horizon": 0.3})
