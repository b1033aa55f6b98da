"""`omniman record` of topics that the tests publish."""

import signal
from collections import Counter
from types import SimpleNamespace

import pytest

pytest.importorskip("rosbags", reason="rosbags is not installed (extra 'record')")

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Int32, String

from omniman_ros.cli.main import main
from omniman_ros.cli.record import TopicRecorder, report
from omniman_ros.console.session import Session
from omniman_ros.recording.definitions import MessageDefinitions
from omniman_ros.recording.reader import BagReader
from test.running import PATIENCE, Running, command, environment

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
UNRELIABLE = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
MANY = QoSProfile(depth=2000)
COUNT = 1500


@pytest.mark.processes
def test_the_topics_of_a_robot_are_recorded_until_ctrl_c(own_domain, tmp_path):
    folder = tmp_path / "bag"
    with Session("talker") as session:
        node = session.node
        latched = node.create_publisher(String, "robot1/active_source", LATCHED)
        latched.publish(String(data="published before"))
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
            session.spin(0.5)  # discovered on this side; the other side cannot be observed
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
        messages = list(bag.messages(bag.topic_types))
    assert f"{len(messages)} messages" in recorder.output
    data = {}
    for topic, _, message in messages:
        data.setdefault(topic, []).append(message.data)
    assert set(data.pop("/robot1/unreliable")) == {7}
    assert data == {
        "/robot1/active_source": ["published before"],
        "/robot1/count": list(range(COUNT)),
    }
    metadata = (folder / "metadata.yaml").read_text()
    assert str(info.topic_type_hash) in metadata
    assert "transient_local" in metadata and "best_effort" in metadata
    assert "hidden" not in metadata and "robot2" not in metadata


@pytest.mark.processes
def test_it_ends_after_its_duration_and_reports_topics_without_publishers(own_domain, tmp_path):
    arguments = ("record", "odom", "--duration", "0.6", "--output", str(tmp_path / "bag"))
    with Running(command(*arguments), environment(own_domain)) as recorder:
        assert recorder.finish() == 1
    assert "no message was received" in recorder.output
    assert "nobody published /odom" in recorder.output


@pytest.mark.parametrize(
    ("arguments", "message"),
    [(["--output", "."], "exists"), (["--duration", "0"], "--duration must be above 0, got 0")],
)
def test_invalid_options_are_refused_before_recording(arguments, message, capsys):
    assert main(["record", *arguments]) == 2
    assert message in capsys.readouterr().err


class FakeNode:
    """A node that sees topics, and notes its subscriptions."""

    def __init__(self, **topics):
        self.topics = topics
        self.subscribed = []
        self.destroyed = []

    def get_topic_names_and_types(self):
        return [(f"/{name}", [kind]) for name, (kind, _) in self.topics.items()]

    def get_publishers_info_by_topic(self, name):
        _, offers = self.topics[name.strip("/")]
        return [SimpleNamespace(qos_profile=profile) for profile in offers]

    def create_subscription(self, kind, name, callback, qos, **options):
        self.subscribed.append((name, qos.reliability, qos.durability))
        return SimpleNamespace(msg_type=kind, name=name)

    def destroy_subscription(self, subscription):
        self.destroyed.append(subscription.name)


class FakeWriter:
    """A writer that notes the names of the topics."""

    def __init__(self):
        self.topics = []
        self.dropped = Counter()

    def add_topic(self, topic):
        self.topics.append(topic.name)

    def put(self, *_):
        return True


def make_recorder(node, writer, wanted=(), namespace=""):
    return TopicRecorder(node, writer, MessageDefinitions(), wanted, namespace)


RELIABLE, BEST_EFFORT = ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT
VOLATILE, TRANSIENT = DurabilityPolicy.VOLATILE, DurabilityPolicy.TRANSIENT_LOCAL
STRING = "std_msgs/msg/String"


def test_a_subscription_has_the_best_quality_of_service_that_all_publishers_offer():
    node = FakeNode(
        a=(STRING, [LATCHED, LATCHED]),
        b=(STRING, [LATCHED, QoSProfile(depth=1)]),
        c=(STRING, [UNRELIABLE, QoSProfile(depth=1)]),
    )
    make_recorder(node, FakeWriter()).discover()
    assert node.subscribed == [
        ("/a", RELIABLE, TRANSIENT),
        ("/b", RELIABLE, VOLATILE),
        ("/c", BEST_EFFORT, VOLATILE),
    ]


def test_a_later_publisher_that_offers_less_is_recorded_too():
    node, writer = FakeNode(a=(STRING, [LATCHED])), FakeWriter()
    recorder = make_recorder(node, writer)
    recorder.discover()
    node.topics["a"][1].append(UNRELIABLE)
    recorder.discover()
    recorder.discover()
    assert node.subscribed == [("/a", RELIABLE, TRANSIENT), ("/a", BEST_EFFORT, VOLATILE)]
    assert node.destroyed == ["/a"]
    assert writer.topics == ["/a"]


def test_a_topic_whose_type_is_not_installed_is_skipped_with_one_warning(capsys):
    node = FakeNode(a=("nowhere_msgs/msg/X", [LATCHED]), b=(STRING, [LATCHED]))
    writer = FakeWriter()
    recorder = make_recorder(node, writer)
    recorder.discover()
    recorder.discover()
    assert writer.topics == ["/b"]
    assert capsys.readouterr().err.count("without /a: nowhere_msgs/msg/X is not installed") == 1


def test_a_namespace_selects_its_topics_and_those_that_robots_share():
    offers = (STRING, [LATCHED])
    node = FakeNode(
        **{
            "robot1/odom": offers,
            "robot10/odom": offers,
            "odom": offers,
            "tf": offers,
            "diagnostics": offers,
            "robot1/follow/_action/status": offers,
        }
    )
    writer = FakeWriter()
    make_recorder(node, writer, namespace="robot1").discover()
    assert writer.topics == ["/robot1/odom", "/tf", "/diagnostics"]


def test_a_topic_without_a_publisher_is_missing_until_it_has_one():
    node, writer = FakeNode(a=(STRING, []), b=(STRING, [LATCHED])), FakeWriter()
    recorder = make_recorder(node, writer, wanted=["/a"])
    recorder.discover()
    assert (recorder.missing, writer.topics) == (["/a"], [])
    node.topics["a"][1].append(LATCHED)
    recorder.discover()
    assert (recorder.missing, writer.topics) == ([], ["/a"])


def test_lost_or_dropped_messages_are_reported_and_fail_the_command(tmp_path, capsys):
    def outcome(**given):
        writer = SimpleNamespace(
            written=Counter({"/a": 5}), dropped=Counter(), failure="", size=10
        )
        recorder = SimpleNamespace(lost=Counter(), missing=[])
        for name, value in given.items():
            setattr(writer if hasattr(writer, name) else recorder, name, value)
        code = report(tmp_path, writer, recorder, 1.0)
        return code, capsys.readouterr().err

    assert outcome() == (0, "")
    for given, text in (
        ({"dropped": Counter({"/a": 2})}, "2 messages dropped"),
        ({"lost": Counter({"/a": 3})}, "3 messages lost on the way"),
        ({"failure": "disk full"}, "disk full"),
    ):
        code, warning = outcome(**given)
        assert code == 1 and text in warning
