import pytest

from test.tiers import combinations


@pytest.mark.parametrize("axes", [("abc", "xy"), ("ab", "uvwxyz", "123"), ("a",), ("ab", "xy")])
def test_the_suite_tries_each_value_in_as_few_combinations_as_that_takes(axes):
    made = combinations(*axes)
    tried = [case.values for case in made if case.marks == ()]
    assert len(tried) == max(map(len, axes))
    assert [set(values) for values in zip(*tried, strict=True)] == [set(axis) for axis in axes]
    assert len({case.values for case in made}) == len(made)
    count = 1
    for axis in axes:
        count *= len(axis)
    assert len(made) == count, "the others are tried by hand"
