"""The third-party client ur_rtde (SDU Robotics, PyPI: ur-rtde) with the simulated controller.

The client only uses the standard ports, so the controller has an address of its own: all of
127.0.0.0/8 is this machine. The client holds Python's lock while it connects, so the controller
is a separate process.
"""

import math
import os
import sys

import pytest

from test.running import Running, environment, wait_until

pytestmark = [
    pytest.mark.processes,
    pytest.mark.skipif(sys.platform != "linux", reason="only 127.0.0.1 is this machine"),
]

receive = pytest.importorskip("rtde_receive")
control = pytest.importorskip("rtde_control")
dashboard = pytest.importorskip("dashboard_client")

TOLERANCE = 0.002  #: Allowed distance of joints at rest from their target [rad]
STOPPED, PLAYING = 1, 2
"""runtime_state."""
INITIAL = [-1.6007, -1.7271, -2.203, -0.808, 1.5951, -0.031]


@pytest.fixture(scope="module")
def address():
    """Yield the address of a running controller."""
    number = os.getpid()
    where = f"127.{number >> 16 & 63 | 64}.{number >> 8 & 255}.{number & 255 or 1}"
    code = "import sys; from omniman_ros.nodes.simulated_ur import main; sys.exit(main())"
    arguments = [sys.executable, "-c", code, "--ros-args", "-p", f"ports.address:={where}"]
    with Running(arguments, environment()) as running:
        running.wait_for("listening at")
        yield where
        running.process.terminate()
        assert running.finish() == 0, running.output


@pytest.fixture
def arm(address):
    """Yield the two interfaces of ur_rtde: receive and control."""
    reader = receive.RTDEReceiveInterface(address)
    mover = control.RTDEControlInterface(address)
    yield reader, mover
    if reader.getRuntimeState() == PLAYING:
        mover.stopScript()
    wait_until(lambda: reader.getRuntimeState() == STOPPED, "the end of its program")
    mover.disconnect()
    reader.disconnect()


def test_joints_and_modes_are_read(address):
    reader = receive.RTDEReceiveInterface(address)
    assert reader.isConnected()
    assert reader.getActualQ() == pytest.approx(INITIAL, abs=TOLERANCE)
    assert (reader.getRobotMode(), reader.getSafetyMode(), reader.getRuntimeState()) == (7, 1, 1)
    assert reader.getRobotStatus() == 1 and reader.getSafetyStatusBits() == 1
    # CB3 by the pose of its flange: x, y, z of the UR5's links.
    assert reader.getActualTCPPose()[:3] == pytest.approx([-0.1201, -0.4318, 0.1461], abs=1e-3)
    before = reader.getTimestamp()
    wait_until(lambda: reader.getTimestamp() > before + 0.1, "time to pass")
    reader.disconnect()


def test_movej_and_servoj_move_the_arm_to_the_target(arm):
    reader, mover = arm
    assert mover.isProgramRunning()
    goal = [q + 0.2 for q in INITIAL]
    assert mover.moveJ(goal, 1.05, 1.4)
    assert reader.getActualQ() == pytest.approx(goal, abs=TOLERANCE)
    for k in range(126):
        begin = mover.initPeriod()
        aside = 0.1 * (1.0 - math.cos(2.0 * math.pi * k / 250.0))
        assert mover.servoJ([q + aside for q in goal], 0.0, 0.0, 0.008, 0.1, 300.0)
        mover.waitPeriod(begin)
    aim = [q + 0.2 for q in goal]
    wait_until(
        lambda: reader.getActualQ() == pytest.approx(aim, abs=TOLERANCE), "the last setpoint"
    )
    assert mover.servoStop()
    assert reader.getSafetyMode() == 1
    assert mover.moveJ(INITIAL, 1.05, 1.4)
    assert reader.getActualQ() == pytest.approx(INITIAL, abs=TOLERANCE)


def test_speedj_is_stopped(arm):
    reader, mover = arm
    assert mover.speedJ([0.2, 0, 0, 0, 0, 0], 0.5, 5.0)
    wait_until(lambda: reader.getActualQd()[0] > 0.15, "speed")
    assert mover.speedStop(10.0)
    wait_until(lambda: abs(reader.getActualQd()[0]) < 0.001, "rest")
    assert mover.moveJ(INITIAL, 1.05, 1.4)


def test_protective_stop_is_reported_and_not_unlocked_at_once(arm, address):
    reader, mover = arm
    pendant = dashboard.DashboardClient(address)
    pendant.connect()
    assert pendant.robotmode() == "Robotmode: RUNNING"
    assert pendant.running()
    assert pendant.polyscopeVersion() == "3.15.8.106339"
    # A jump of 2.9 rad, which this client passes on.
    mover.servoJ([INITIAL[0] + 2.9, *INITIAL[1:]], 0.0, 0.0, 0.008, 0.1, 300.0)
    wait_until(lambda: reader.getSafetyMode() == 3, "a protective stop")
    assert reader.isProtectiveStopped()
    assert abs(reader.getActualQ()[0] - INITIAL[0]) < 0.5
    with pytest.raises(RuntimeError, match="until 5s after occurrence"):
        pendant.unlockProtectiveStop()
    assert reader.getSafetyMode() == 3
    begin = reader.getTimestamp()
    wait_until(lambda: reader.getTimestamp() > begin + 5.1, "5 s")
    pendant.stop()
    pendant.unlockProtectiveStop()
    wait_until(lambda: reader.getSafetyMode() == 1, "its release")
    pendant.disconnect()
    # Reloading its program would repeat the jump: the command is still in its registers.
    where = reader.getActualQ()
    begin = reader.getTimestamp()
    wait_until(lambda: reader.getTimestamp() > begin + 0.5, "time to pass")
    assert reader.getActualQ() == pytest.approx(where, abs=1e-6)
