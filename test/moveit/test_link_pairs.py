"""Unchecked pairs of links against a physics engine that reads the URDF."""

import numpy as np
import pytest

from omniman_ros.core.parameters import build
from omniman_ros.description.parameters import DescriptionParameters
from omniman_ros.moveit.link_pairs import Reason, unchecked_pairs
from omniman_ros.robots import robot_parameters

mujoco = pytest.importorskip("mujoco", reason="the reference is a physics engine")

POSTURES = 200
FAR = 10.0


def describe(name):
    return build(DescriptionParameters, robot_parameters(name))


def test_no_pair_that_is_said_to_be_clear_ever_touches():
    description = describe("omniman")
    pairs = [p for p in unchecked_pairs(description) if p.reason is Reason.NEVER]
    spec = mujoco.MjSpec.from_string(description.urdf)
    spec.compiler.fusestatic = False
    model = spec.compile()
    data = mujoco.MjData(model)
    joints = [model.joint(name).qposadr[0] for name in description.arm.joints]
    shapes = {
        body: [g for g in range(model.ngeom) if model.geom_bodyid[g] == model.body(body).id]
        for pair in pairs
        for body in (pair.first, pair.second)
    }
    assert len(pairs) > 10 and all(shapes.values())
    low, high = (description.arm.each(label) for label in ("lower", "upper"))
    for q in np.random.default_rng(7).uniform(low, high, (POSTURES, 6)):
        data.qpos[joints] = q
        mujoco.mj_kinematics(model, data)
        for pair in pairs:
            for a in shapes[pair.first]:
                for b in shapes[pair.second]:
                    distance = mujoco.mj_geomDistance(model, data, a, b, FAR, None)
                    assert distance > 0.0, (pair, q)


def test_the_pairs_are_the_same_each_time():
    description = describe("omniman")
    assert unchecked_pairs(description) == unchecked_pairs(description)
