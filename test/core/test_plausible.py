import math

import numpy as np
import pytest

from omniman_ros.core import plausible
from omniman_ros.core.errors import InputError


@pytest.mark.parametrize("values", [[], [0.0], [2.0, -2.0]])
def test_numbers_up_to_the_bound_are_accepted(values):
    plausible.demand(np.array(values), 2.0, "speeds")


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 2.001, -1e300])
@pytest.mark.parametrize("place", [0, 1, 2])
def test_single_implausible_number_is_rejected_with_label_and_bound(bad, place):
    values = np.zeros(3)
    values[place] = bad
    with pytest.raises(InputError, match=r"^speeds .*beyond \+-2$"):
        plausible.demand(values, 2.0, "speeds")


def test_every_bound_can_be_squared_without_overflow():
    bounds = [value for name, value in vars(plausible).items() if name.isupper()]
    assert len(bounds) > 5
    assert all(bound > 0 and math.isfinite(bound**3) for bound in bounds)


def test_long_array_is_abbreviated_in_the_message():
    values = np.zeros(100_000)
    values[[5, 70_000]] = math.nan, 2e9
    with pytest.raises(InputError) as caught:
        plausible.demand(values, 1.0, "x")
    assert len(str(caught.value)) < 200
    assert "nan" in str(caught.value) and "2000000000.0" in str(caught.value)
