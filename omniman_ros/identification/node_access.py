"""Access to the nodes of a robot: their parameters, and QoS profiles for their topics."""

from collections.abc import Sequence
from typing import Any

from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import GetParameters
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import DurabilityPolicy, QoSProfile

from omniman_ros.console.errors import CommandError
from omniman_ros.console.session import Session

SIM_TIME = "use_sim_time"  #: Parameter of every node: whether it runs on simulated time
#: QoS profile of topics whose last message reaches late subscribers, too
LATCHED = QoSProfile(depth=50, durability=DurabilityPolicy.TRANSIENT_LOCAL)
LOSSLESS = QoSProfile(depth=400)  #: Queues two seconds of wheel_states, so that none is lost
RESPONSE_TIMEOUT = 5.0  #: Longest time to wait for a node's response [s]


def read_parameters(
    session: Session, client: Any, node_name: str, names: Sequence[str]
) -> dict[str, Any]:
    """Read parameters of a node.

    Returns:
        The values by name; parameters that the node does not have are absent.

    Raises:
        CommandError: The node does not answer.
    """
    # Each request has one name: one that the node does not have would leave the response empty.
    values = {}
    for name in names:
        future = client.call_async(GetParameters.Request(names=[name]))
        if not session.wait(future.done, RESPONSE_TIMEOUT):
            raise CommandError(
                f"{node_name} does not report '{name}' within {RESPONSE_TIMEOUT:g} s"
            )
        for answer in future.result().values:
            if answer.type != ParameterType.PARAMETER_NOT_SET:
                values[name] = parameter_value_to_python(answer)
    return values
