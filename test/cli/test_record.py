"""`omniman record` beside publishers of the test's own."""

import signal
from collections import Counter
from types import SimpleNamespace

import pytest

pytest.importorskip("rosbags", reason="rosbags is not installed (extra 'record')")

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Int32, String

from omniman_ros.bag.definitions import Definitions
from omniman_ros.bag.reader import BagReader
from omniman_ros.cli.main import main
from omniman_ros.cli.record import Ears, report
from omniman_ros.cli.session import Session

from .support import PATIENCE, Running, command, environment

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
UNRELIABLE = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
MANY = QoSProfile(depth=2000)
COUNT = 1500


@pytest.mark.processes
def test_what_a_robot_says_is_recorded_until_ctrl_c(own_domain, tmp_path):
    folder = tmp_path / "bag"
    with Session("talker") as session:
        node = session.node
        latched = node.create_publisher(String, "robot1/active_source", LATCHED)
        latched.publish(String(data="said before"))
        counted = node.create_publisher(Int32, "robot1/count", MANY)
        unreliable = node.create_publisher(Int32, "robot1/unreliable", UNRELIABLE)
        node.create_publisher(Int32, "robot1/x/_action/hidden", 10)
        other = node.create_publisher(Int32, "robot2/count", 10)
        arguments = command("record", "--namespace", "robot1", "--output", str(folder))
        with Running(arguments, environment(own_domain)) as recorder:
            recorder.wait_for("Ctrl-C ends it")
            publishers = (latched, counted, unreliable)
            assert session.wait(
                lambda: all(p.get_subscription_count() for p in publishers), PATIENCE
            )
            session.spin(0.5)  # matched on this side; the other side is not told of
            for number in range(COUNT):
                counted.publish(Int32(data=number))
            for _ in range(10):
                unreliable.publish(Int32(data=7))
                session.spin(0.02)
            other.publish(Int32(data=-1))
            counted.wait_for_all_acked()
            session.spin(0.5)
            (info,) = node.get_publishers_info_by_topic("/robot1/count")
            recorder.process.send_signal(signal.SIGINT)
            assert recorder.finish() == 0, recorder.output
    with BagReader(folder) as bag:
        heard = list(bag.messages(bag.kinds))
    assert f"{len(heard)} messages" in recorder.output
    said = {}
    for topic, _, message in heard:
        said.setdefault(topic, []).append(message.data)
    assert set(said.pop("/robot1/unreliable")) == {7}
    assert said == {
        "/robot1/active_source": ["said before"],
        "/robot1/count": list(range(COUNT)),
    }
    metadata = (folder / "metadata.yaml").read_text()
    assert str(info.topic_type_hash) in metadata
    assert "transient_local" in metadata and "best_effort" in metadata
    assert "hidden" not in metadata and "robot2" not in metadata


@pytest.mark.processes
def test_it_ends_by_itself_and_tells_what_nobody_said(own_domain, tmp_path):
    arguments = ("record", "odom", "--duration", "0.6", "--output", str(tmp_path / "bag"))
    with Running(command(*arguments), environment(own_domain)) as recorder:
        assert recorder.finish() == 1
    assert "nothing was heard" in recorder.output
    assert "nobody published /odom" in recorder.output


@pytest.mark.parametrize(
    ("arguments", "message"),
    [(["--output", "."], "exists"), (["--duration", "0"], "--duration must be above 0, got 0")],
)
def test_what_cannot_be_recorded_is_refused_before_anything_is_heard(arguments, message, capsys):
    assert main(["record", *arguments]) == 2
    assert message in capsys.readouterr().err


class Graph:
    """A node that sees topics and hears nothing."""

    def __init__(self, **topics):
        self.topics = topics
        self.asked = []
        self.gone = []

    def get_topic_names_and_types(self):
        return [(f"/{name}", [kind]) for name, (kind, _) in self.topics.items()]

    def get_publishers_info_by_topic(self, name):
        _, offers = self.topics[name.strip("/")]
        return [SimpleNamespace(qos_profile=profile) for profile in offers]

    def create_subscription(self, kind, name, callback, qos, **options):
        self.asked.append((name, qos.reliability, qos.durability))
        return SimpleNamespace(msg_type=kind, name=name)

    def destroy_subscription(self, subscription):
        self.gone.append(subscription.name)


class Paper:
    """A writer that keeps names."""

    def __init__(self):
        self.topics = []
        self.dropped = Counter()

    def add(self, topic):
        self.topics.append(topic.name)

    def put(self, *_):
        return True


def ears(graph, paper, wanted=(), namespace=""):
    return Ears(graph, paper, Definitions(), wanted, namespace)


RELIABLE, BEST_EFFORT = ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT
VOLATILE, TRANSIENT = DurabilityPolicy.VOLATILE, DurabilityPolicy.TRANSIENT_LOCAL
STRING = "std_msgs/msg/String"


def test_a_topic_is_asked_for_as_all_of_its_publishers_offer_it():
    graph = Graph(
        a=(STRING, [LATCHED, LATCHED]), b=(STRING, [LATCHED, QoSProfile(depth=1)]),
        c=(STRING, [UNRELIABLE, QoSProfile(depth=1)]),
    )  # fmt: skip
    ears(graph, Paper()).look()
    assert graph.asked == [
        ("/a", RELIABLE, TRANSIENT), ("/b", RELIABLE, VOLATILE), ("/c", BEST_EFFORT, VOLATILE)
    ]  # fmt: skip


def test_a_publisher_that_comes_later_and_offers_less_is_heard_too():
    graph, paper = Graph(a=(STRING, [LATCHED])), Paper()
    hearing = ears(graph, paper)
    hearing.look()
    graph.topics["a"][1].append(UNRELIABLE)
    hearing.look()
    hearing.look()
    assert graph.asked == [("/a", RELIABLE, TRANSIENT), ("/a", BEST_EFFORT, VOLATILE)]
    assert graph.gone == ["/a"]
    assert paper.topics == ["/a"]


def test_a_type_that_is_not_here_is_left_out_with_a_word_and_once(capsys):
    graph, paper = Graph(a=("nowhere_msgs/msg/X", [LATCHED]), b=(STRING, [LATCHED])), Paper()
    hearing = ears(graph, paper)
    hearing.look()
    hearing.look()
    assert paper.topics == ["/b"]
    assert capsys.readouterr().err.count("without /a: nowhere_msgs/msg/X is not installed") == 1


def test_a_robot_has_its_own_topics_and_those_that_robots_share():
    offers = (STRING, [LATCHED])
    graph = Graph(**{
        "robot1/odom": offers, "robot10/odom": offers, "odom": offers, "tf": offers,
        "diagnostics": offers, "robot1/follow/_action/status": offers,
    })  # fmt: skip
    paper = Paper()
    ears(graph, paper, namespace="robot1").look()
    assert paper.topics == ["/robot1/odom", "/tf", "/diagnostics"]


def test_a_topic_without_a_publisher_is_waited_for():
    graph, paper = Graph(a=(STRING, []), b=(STRING, [LATCHED])), Paper()
    hearing = ears(graph, paper, wanted=["/a"])
    hearing.look()
    assert (hearing.missing, paper.topics) == (["/a"], [])
    graph.topics["a"][1].append(LATCHED)
    hearing.look()
    assert (hearing.missing, paper.topics) == ([], ["/a"])


def test_what_was_lost_or_dropped_is_told_and_no_success(tmp_path, capsys):
    def told(**given):
        writer = SimpleNamespace(written=Counter({"/a": 5}), dropped=Counter(), failure="",
                                 size=10)  # fmt: skip
        hearing = SimpleNamespace(lost=Counter(), missing=[])
        for name, value in given.items():
            setattr(writer if hasattr(writer, name) else hearing, name, value)
        code = report(tmp_path, writer, hearing, 1.0)
        return code, capsys.readouterr().err

    assert told() == (0, "")
    for given, word in (
        ({"dropped": Counter({"/a": 2})}, "2 messages dropped"),
        ({"lost": Counter({"/a": 3})}, "3 messages lost on the way"),
        ({"failure": "disk full"}, "disk full"),
    ):
        code, text = told(**given)
        assert code == 1 and word in text
