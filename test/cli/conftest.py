import pytest

from omniman_ros.cli.isolation import free_domain


@pytest.fixture
def own_domain(monkeypatch):
    """This process, and what it starts, in a ROS domain of the test's own."""
    domain = free_domain()
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    return domain
