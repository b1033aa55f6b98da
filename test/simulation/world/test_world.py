"""The world as a whole: repeatability, pose, parameters in motion, energy."""

import json
import math
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from omniman_ros.core.errors import InputError, OmnimanError, ParameterError
from omniman_ros.simulation.scene_files import load_scene
from omniman_ros.simulation.world.scene import Load, Person, Post, Scene, Wall
from test.simulation.world.support import Bench, ideal, rollers


def test_two_runs_are_equal_to_the_last_bit():
    def run():
        bench = rollers("omniman", load_scene("shop_floor"))
        bench.world.arm.command([0.3, -1.2, 0.8, 0.0, 0.5, 0.0])
        bench.drive((0.2, 0.1, 0.3), 0.5)
        world = bench.world
        return b"".join(
            values.tobytes()
            for values in (world.pose, world.twist, world.wheel_loads, world.arm.positions)
        )

    assert run() == run()


@pytest.mark.parametrize("make", [ideal, rollers])
def test_a_robot_at_rest_stays_where_it_is(make):
    bench = make("omniman")
    bench.wait(2.0)
    np.testing.assert_allclose(bench.world.pose, 0.0, atol=2e-4)
    np.testing.assert_allclose(bench.world.twist, 0.0, atol=1e-4)


def test_set_pose_turns_the_motion_with_the_robot():
    bench = ideal("ig42")
    bench.drive((0.3, 0.0, 0.0), 1.5)
    twist = bench.world.twist
    bench.drives.set_pose([5.0, -2.0, math.pi / 2])
    np.testing.assert_allclose(bench.world.pose, [5.0, -2.0, math.pi / 2], atol=1e-9)
    np.testing.assert_allclose(bench.world.twist, twist, atol=1e-9)
    bench.drive((0.3, 0.0, 0.0), 1.0)
    np.testing.assert_allclose(bench.world.pose[:2], [5.0, -1.7], atol=0.005)


def test_a_scene_tells_where_the_robot_starts():
    bench = ideal("ig42", Scene(start=(1.0, 2.0, -0.5)))
    bench.wait(0.1)
    np.testing.assert_allclose(bench.world.pose, [1.0, 2.0, -0.5], atol=1e-4)


def test_the_robot_is_put_upright_and_nowhere_into_a_thing():
    post = Post(name="post", x=3.0, y=0.0)
    bench = rollers("ig42", Scene(posts=(post,)))
    bench.drive((0.2, 0.0, 0.0), 0.5)
    pose = bench.world.pose
    with pytest.raises(InputError, match="post"):
        bench.drives.set_pose([2.8, 0.1, 0.3])
    np.testing.assert_allclose(bench.world.pose, pose, atol=1e-12)
    bench.drives.set_pose([2.0, 0.1, 0.3])
    bench.wait(0.5)
    assert bench.world.base_frame[1][2, 2] == pytest.approx(1.0, abs=1e-5)
    assert bench.world.base_frame[0][2] == pytest.approx(0.0, abs=1e-3)


def test_a_start_within_a_thing_is_refused():
    with pytest.raises(ParameterError, match="wall"):
        ideal("ig42", Scene(walls=(Wall(name="wall", x=(0.0, 0.0), y=(-1.0, 1.0)),)))


def test_loads_are_put_where_the_robot_is_put():
    load = Load(name="part", x=0.1, y=0.05, mass=3.0, length=0.1, width=0.1)
    bench = ideal("ig42", Scene(start=(1.0, 2.0, 0.5), loads=(load,)))
    bench.wait(0.5)
    weight = (25.0 + 3.0) * 9.81
    assert bench.world.wheel_loads.sum() == pytest.approx(weight, rel=1e-3)
    bench.drives.set_pose([-3.0, 1.0, -2.0])
    bench.wait(0.5)
    assert bench.world.wheel_loads.sum() == pytest.approx(weight, rel=1e-3)
    assert {contact.element for contact in bench.world.contacts} == {"part"}


def test_a_heavier_body_takes_over_in_motion():
    """The speed is kept, the wheels carry the new weight, and the energy is told."""
    bench = ideal("ig42")
    bench.drive((0.3, 0.0, 0.0), 1.5)
    pose, twist = bench.world.pose, bench.world.twist
    heavy = replace(bench.robot, body=replace(bench.robot.body, mass=50.0))
    bench.drives.configure(heavy, bench.simulation)
    np.testing.assert_array_equal(bench.world.pose, pose)
    np.testing.assert_allclose(bench.world.twist, twist, atol=1e-12)
    bench.drive((0.3, 0.0, 0.0), 1.0)
    assert bench.world.wheel_loads.sum() == pytest.approx(50.0 * 9.81, rel=1e-3)
    energy = bench.world.energy
    assert energy.external > 0.9 * 0.5 * 25.0 * 0.3**2
    assert abs(energy.residual) < 0.01 * energy.turnover


@pytest.mark.parametrize("name", ["radius", "torque_constant"])
def test_refused_parameters_change_nothing(name):
    bench = ideal("ig42")
    mismatch = replace(bench.simulation.mismatch, **{name: (1.0, 2.0)})
    wrong = replace(bench.simulation, mismatch=mismatch)
    with pytest.raises(ParameterError, match=name):
        bench.drives.configure(bench.robot, wrong)
    bench.drive((0.3, 0.0, 0.0), 1.0)
    assert bench.world.twist[0] == pytest.approx(0.3, rel=0.02)


@pytest.mark.parametrize(("name", "value"), [("substep", 0.002), ("lifted", True)])
def test_a_world_refuses_long_steps_and_blocks(name, value):
    with pytest.raises(ParameterError, match=name):
        Bench("ig42", **{f"plant__{name}": value})


@pytest.mark.parametrize("twist", [(0.5, 0.0, 0.0), (0.0, 0.5, 0.0), (0.2, -0.2, 0.6)])
def test_energy_on_ideal_wheels_balances(twist):
    """Electrical energy becomes losses, or is still there; none is the remainder of others."""
    bench = ideal("ig42")
    bench.wait(0.5)
    bench.drive(twist, 1.5)
    energy = bench.world.energy
    assert energy.kinetic > 0.5
    assert abs(energy.residual) < 0.01 * energy.turnover


def test_energy_on_rollers_is_lost_in_their_hand_over_only():
    bench = rollers("ig42")
    bench.drive((0.0, 0.3, 0.0), 2.0)
    energy = bench.world.energy
    assert 0.0 < energy.residual < 0.1 * energy.turnover


def test_a_state_that_is_not_finite_is_told(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # the engine logs there
    bench = ideal("ig42")
    bench.world.engine.velocities[:] = math.nan
    with pytest.raises(OmnimanError, match="not finite"):
        bench.wait(0.01)


def test_obstacles_are_told_as_they_are():
    scene = Scene(persons=(Person(name="anna", x=(2.0,), y=(1.0,)),))
    bench = ideal("ig42", scene)
    bench.wait(0.2)
    (anna,) = bench.world.obstacles
    assert (anna.name, anna.size, anna.is_round) == ("anna", (0.5, 0.5, 1.7), True)
    assert anna.pose == pytest.approx((2.0, 1.0, 0.0))


def test_two_things_cannot_have_the_robots_names():
    with pytest.raises(ParameterError, match="base_link"):
        ideal("ig42", Scene(posts=(Post(name="base_link", x=2.0, y=0.0),)))


WITHOUT_NETWORK = """
import sys
def refuse(event, arguments):
    if event.startswith("socket."):
        raise RuntimeError(event)
sys.addaudithook(refuse)
from omniman_ros.share import share_path
from test.simulation.world.support import rollers
from omniman_ros.simulation.scene_files import load_scene
for file in sorted(share_path("config", "worlds").glob("*.yaml")):
    rollers("omniman", load_scene(file.stem)).wait(0.01)
    print(file.stem)
"""


def test_the_shipped_worlds_need_no_network():
    run = [sys.executable, "-c", WITHOUT_NETWORK]
    result = subprocess.run(run, capture_output=True, text=True, timeout=60)
    assert result.returncode == 0, result.stderr
    assert {"empty", "workshop", "corridor", "shop_floor", "clutter", "hall"} <= set(
        result.stdout.split()
    )


WITHOUT_ENGINE = """
import importlib, json, pathlib, sys
sys.modules["mujoco"] = None
import omniman_ros
from omniman_ros.extras import WORLD
root = pathlib.Path(omniman_ros.__file__).parent
failed = []
for room in ("core", "description", "simulation"):
    for path in sorted((root / room).rglob("*.py")):
        name = ".".join(path.relative_to(root.parent).with_suffix("").parts)
        try:
            importlib.import_module(name.removesuffix(".__init__"))
        except ModuleNotFoundError as error:
            assert "mujoco" in str(error), error
            failed.append(name)
import omniman_ros.lab.bench.world, omniman_ros.nodes.registry
print(json.dumps([WORLD.is_available, WORLD.hint, failed]))
"""


def test_without_the_engine_all_but_the_running_world_can_be_imported():
    run = [sys.executable, "-c", WITHOUT_ENGINE]
    result = subprocess.run(run, capture_output=True, text=True, check=True, timeout=60)
    available, hint, failed = json.loads(result.stdout)
    assert not available
    assert "pip install 'mujoco-core==4.*'" in hint
    running = ("engine", "world", "base", "tyres", "contacts", "arm_servo", "scanner")
    running += ("crowd", "surroundings", "distances")
    assert set(failed) == {f"omniman_ros.simulation.world.{name}" for name in running}
