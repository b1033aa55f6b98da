from dataclasses import replace
from functools import cache

import casadi as ca
import numpy as np
import pytest

from omniman_ros.collision.rectangles import Rectangles
from omniman_ros.planning.mpc.gap_rows import OBSTACLE
from omniman_ros.planning.mpc.model import STATES
from omniman_ros.planning.mpc.problem import farthest_points
from omniman_ros.planning.mpc.solver import Solver
from omniman_ros.planning.mpc.transcription import SIDES, Stage, Transcription
from omniman_ros.planning.obstacles.separation import box_gap
from test import robots
from test.planning.support import ellipses, model, true_gaps

STEPS, STEP, SLOTS = 4, 0.1, 2
WIDE = 1e3  #: A limit that holds nothing back


@cache
def transcription(name="ig42", steps=STEPS, step=STEP, slots=SLOTS, damping=1.0):
    return Transcription(model(name), steps, step, slots, damping=damping)


def obstacle(x, y, a, b, angle=0.0):
    """Return an obstacle at rest in the layout of a stage."""
    half = model("ig42").half
    box = 0.0, 0.0, 1.0, 0.0, *half, np.hypot(*half)
    return np.array([x, y, np.cos(angle), np.sin(angle), a, b, 0.0, 0.0, *box])


def a_stage(steps=STEPS, limits=WIDE, obstacles=(), slots=SLOTS, target=(0.4, 0.2, 0.3), box=9.0):
    """Return stage parameters with nothing in the way unless changed."""
    table = np.zeros((steps, slots, OBSTACLE))
    table[:] = obstacle(50.0, 50.0, 1.0, 1.0)
    for slot, row in enumerate(obstacles):
        table[:, slot] = row
    weights = np.tile([40.0, 20.0, 3.0, 1.0, 0.0], (steps, 1))
    weights[-1] = [200.0, 100.0, 10.0, 4.0, 1.5]
    return Stage(
        limits=np.broadcast_to(np.array(limits, float), (steps, 6)),
        workspace=np.array([-box, -box, box, box]),
        target=np.tile([*target, 0.2, -0.1, 0.1], (steps, 1)),
        weights=weights,
        energy=0.8,
        slack=(3e3, 3e4),
        obstacles=table,
        extremes=farthest_points(np.zeros(steps), Rectangles.centred(model("ig42").half)),
    )


def a_point(seed, t, speed=0.5, amps=3.0):
    """Draw a start state and currents (n, N)."""
    random = np.random.default_rng(seed)
    start = random.uniform(-1, 1, STATES) * [1, 1, 3, speed, speed, speed]
    return start, amps * random.uniform(-1, 1, (t.controls, t.steps))


def program(t, start, currents, stage):
    """Return the dense program: H, g, A, lower, upper, least, most, cost, states."""
    found = t.program(start, currents, stage.table().T)
    h, g, a, *rest = (np.asarray(part) for part in found)
    h, a = (np.asarray(ca.DM(shape, e)) for shape, e in ((t.h, h.ravel()), (t.a, a.ravel())))
    return [h, g, a, *rest]


def step_of(t, change, start, currents, stage):
    """Return the program's variables for a change of the currents, with predicted states."""
    cons = program(t, start, currents, stage)[2]
    width, rows = t.controls + 1 + STATES, STATES + t.rows
    z = np.zeros(t.steps * width)
    for k in range(t.steps):
        z[k * width : k * width + t.controls] = change[:, k]
        here = cons[k * rows : k * rows + STATES]
        own = slice(k * width + t.controls + 1, (k + 1) * width)
        z[own] = -np.linalg.solve(here[:, own], here @ z)  # the slack's own entry is still zero
    return z


# ---- the model over a step --------------------------------------------------------------------


def fine(planning, start, currents, time, parts=400):
    """Integrate finely to the state after a time and the electric work until then [J]."""
    twist, amps = ca.SX.sym("twist", 3), ca.SX.sym("amps", planning.wheel_count)
    rate = ca.Function("rate", [twist, amps], [planning.twist_rate(twist, amps)])

    def slope(y):
        c, s = np.cos(y[2]), np.sin(y[2])
        moved = [c * y[3] - s * y[4], s * y[3] + c * y[4], y[5]]
        volts = planning.resistance * currents + planning.emf * (planning.J @ y[3:6])
        return np.concatenate(
            [moved, np.asarray(rate(y[3:6], currents)).ravel(), [volts @ currents]]
        )

    y, h = np.append(start, 0.0), time / parts
    for _ in range(parts):
        k1 = slope(y)
        k2 = slope(y + 0.5 * h * k1)
        k3 = slope(y + 0.5 * h * k2)
        y = y + h / 6.0 * (k1 + 2 * k2 + 2 * k3 + slope(y + h * k3))
    return y[:STATES], y[STATES]


def away_from_rest(planning, random):
    """Return a state in which every wheel and roller turns, and currents of mixed signs."""
    while True:
        twist = random.uniform(-1, 1, 3) * [0.8, 0.8, 1.0]
        speeds, _, width = planning.dry_speeds(ca.DM(twist))
        if (np.abs(np.asarray(speeds).ravel()) > 6 * width).all():
            pose = random.uniform(-2, 2, 3)
            return np.append(pose, twist), random.uniform(-1, 1, planning.wheel_count)


@pytest.mark.parametrize("name", ["ig42", "skewed4"])
def test_step_has_the_accuracy_order_of_runge_kutta_4(name):
    planning, random = model(name), np.random.default_rng(1)
    whole, half = transcription(name), transcription(name, step=0.5 * STEP, steps=2, slots=0)
    ratios = []
    for _ in range(5):
        start, currents = away_from_rest(planning, random)
        errors = []
        for t in (whole, half):
            end = np.asarray(t.transition(start, currents)).ravel()
            errors.append(np.abs(end - fine(planning, start, currents, t.step, 100)[0]).max())
        assert errors[0] < 1e-4
        ratios.append(errors[0] / errors[1])
    assert np.median(ratios) > 24  # 2^5: order of the local error of one step


def test_rollout_is_a_sequence_of_steps():
    t = transcription()
    start, currents = a_point(2, t)
    states, x = np.asarray(t.rollout(start, currents)), start
    assert states.shape == (STATES, STEPS)
    for k in range(STEPS):
        x = np.asarray(t.transition(x, currents[:, k])).ravel()
        np.testing.assert_allclose(states[:, k], x)


# ---- energy -----------------------------------------------------------------------------------


def losses(t, start, currents):
    """Return the losses of a step [J]."""
    x, u = ca.SX.sym("x", STATES), ca.SX.sym("u", t.controls)
    total = ca.Function("losses", [x, u], [t.losses(x, u)])
    return float(total(start, currents))


@pytest.mark.parametrize("name", ["ig42", "omniman"])
def test_electric_work_is_losses_plus_change_of_kinetic_energy(name):
    planning, random = model(name), np.random.default_rng(3)
    whole, half = transcription(name), transcription(name, step=0.5 * STEP, steps=2, slots=0)
    ratios, rectangles, found = [], [], []
    for _ in range(8):
        start, currents = away_from_rest(planning, random)
        currents = 3.0 * currents
        errors = []
        for t in (whole, half):
            end, work = fine(planning, start, currents, t.step, 100)
            stored = planning.kinetic_energy(end[3:]) - planning.kinetic_energy(start[3:])
            sum_of = losses(t, start, currents) + stored / planning.efficiency
            errors.append(abs(sum_of - work))
            if t is whole:
                volts = planning.voltages(currents, start[3:])
                scale = STEP * np.abs(volts * currents).sum()
                found.append(errors[0] / scale)
                rectangles.append(abs(STEP * volts @ currents - work) / scale)
        ratios.append(errors[0] / errors[1])
    assert max(found) < 0.01
    assert np.median(ratios) > 12  # 2^4
    assert np.median(rectangles) > 10 * np.median(found)


def test_losses_are_accurate_from_rest_where_the_rectangle_rule_is_not():
    planning, t = model("ig42"), transcription()
    # At speed within half a second: each rectangle uses the speed at its start.
    x, work, sums, rectangles = np.zeros(STATES), 0.0, 0.0, 0.0
    currents = 2.0 * np.ones(4)
    for _ in range(5):
        end, taken = fine(planning, x, currents, STEP, 100)
        sums += losses(t, x, currents)
        rectangles += STEP * planning.voltages(currents, x[3:]) @ currents
        x, work = end, work + taken
    sums += planning.kinetic_energy(x[3:]) / planning.efficiency
    assert sums == pytest.approx(work, rel=0.01)
    assert abs(rectangles - work) > 0.05 * work


def test_cost_of_a_plan_is_energy_plus_weighted_errors():
    planning, t = model("ig42"), transcription()
    start, currents = a_point(4, t)
    stage = a_stage()
    *_, cost, states = program(t, start, currents, stage)
    along = np.column_stack([start, states])
    expected = sum(stage.energy * losses(t, along[:, k], currents[:, k]) for k in range(STEPS))
    for x, target, w in zip(states.T, stage.target, stage.weights, strict=True):
        c, s = np.cos(x[2]), np.sin(x[2])
        velocity = np.array([c * x[3] - s * x[4], s * x[3] + c * x[4], x[5]])
        off = np.append(x[:3] - target[:3], velocity - target[3:])
        expected += w[[0, 0, 1, 2, 2, 3]] @ off**2 + w[4] * planning.kinetic_energy(x[3:])
    assert cost.sum() == pytest.approx(expected)


# ---- derivatives ------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["ig42", "omni3", "mecanum8"])
def test_predicted_states_match_finite_differences(name):
    t = transcription(name)
    stage, (start, currents) = a_stage(), a_point(5, t)
    change = np.random.default_rng(6).uniform(-1, 1, currents.shape)
    z = step_of(t, change, start, currents, stage).reshape(STEPS, -1)[:, t.controls + 1 :].T
    tiny = 1e-5
    ahead, behind = (
        np.asarray(t.rollout(start, currents + sign * tiny * change)) for sign in (1, -1)
    )
    np.testing.assert_allclose(z, (ahead - behind) / (2 * tiny), rtol=1e-5, atol=1e-8)


@pytest.mark.parametrize("name", ["ig42", "omni3", "mecanum8"])
def test_gradient_matches_finite_differences(name):
    t = transcription(name)
    stage, (start, currents) = a_stage(), a_point(7, t)
    _, g, *_ = program(t, start, currents, stage)
    for seed in range(4):
        change = np.random.default_rng(seed).uniform(-1, 1, currents.shape)
        z = step_of(t, change, start, currents, stage)
        tiny = 1e-5
        costs = [
            program(t, start, currents + sign * tiny * change, stage)[7].item() for sign in (1, -1)
        ]
        assert g.ravel() @ z == pytest.approx((costs[0] - costs[1]) / (2 * tiny), rel=1e-5)


@pytest.mark.parametrize("name", ["ig42", "omni3"])
def test_constraint_rows_match_finite_differences(name):
    t = transcription(name)
    limits = (1.0, 2.0, 20.0, 24.0, 1.0, 3.0)
    # The margins between nodes count as constant: those of ellipses so large are.
    rows = [obstacle(3e3 + 2.6, 0.2, 3e3, 3e3), obstacle(-3e3, 2.4, 3e3 - 3.0, 5e3, 0.4)]
    stage, (start, currents) = a_stage(limits=limits, obstacles=rows), a_point(8, t)
    table = stage.table()

    def values(currents):
        states = np.column_stack([start, np.asarray(t.rollout(start, currents))])
        found = [
            [np.asarray(part).ravel() for part in t.stage_rows(states[:, k], currents[:, k], row)]
            for k, row in enumerate(table)
        ]
        return np.array(found).transpose(1, 0, 2)  # value, low, high; step; row

    value, low, high = values(currents)
    _, _, cons, lower, upper, *_ = program(t, start, currents, stage)
    height = STATES + t.rows
    for bound, limit in ((lower, low), (upper, high)):
        bound = bound.reshape(STEPS, height)
        np.testing.assert_allclose(bound[:, :STATES], 0.0)
        np.testing.assert_allclose(bound[:, STATES:], limit - value)
    change = np.random.default_rng(9).uniform(-1, 1, currents.shape)
    z, tiny = step_of(t, change, start, currents, stage), 1e-6
    slopes = (values(currents + tiny * change)[0] - values(currents - tiny * change)[0]) / (
        2 * tiny
    )
    found = (cons @ z).reshape(STEPS, height)[:, STATES:]
    np.testing.assert_allclose(found, slopes, rtol=1e-4, atol=2e-6)
    # The slack relaxes the obstacle and workspace rows only.
    width = t.controls + 1 + STATES
    for k in range(STEPS):
        column = cons[:, k * width + t.controls].reshape(STEPS, height)
        expected = np.zeros((STEPS, height))
        expected[k, STATES + t.relaxed :] = 1.0
        np.testing.assert_allclose(column, expected)
    assert t.rows - t.relaxed == 8 + 2 * SLOTS


@pytest.mark.parametrize("name", ["ig42", "omni3", "mecanum8"])
def test_hessian_is_positive_semidefinite_and_definite_in_the_controls(name):
    t = transcription(name)
    width = t.controls + 1 + STATES
    for seed in range(5):
        start, currents = a_point(seed, t)
        h, *_ = program(t, start, currents, a_stage())
        np.testing.assert_allclose(h, h.T, atol=1e-9)
        values = np.linalg.eigvalsh(h)
        assert values.min() > -1e-9 * values.max()
        controls = [k * width + i for k in range(STEPS) for i in range(t.controls)]
        copper = 2.0 * t.model.resistance * STEP
        assert np.linalg.eigvalsh(h[np.ix_(controls, controls)]).min() > 1.7 * copper


def test_damping_only_adds_to_the_control_block():
    firm, loose = transcription(), transcription(damping=0.0)
    start, currents = a_point(10, firm)
    more = [program(t, start, currents, a_stage())[0] for t in (firm, loose)]
    extra = np.zeros((STEPS, firm.controls + 1 + STATES))
    extra[:, : firm.controls] = 2.0 * firm.model.resistance * STEP
    np.testing.assert_allclose(more[0] - more[1], np.diag(extra.ravel()), atol=1e-9)


# ---- the quadratic program --------------------------------------------------------------------


@pytest.mark.parametrize("name", ["ig42", "omni3", "mecanum8"])
def test_without_active_limits_the_step_solves_the_kkt_system(name):
    t = transcription(name)
    start, currents = a_point(11, t, speed=0.2, amps=0.2)
    stage = a_stage(target=(*(start[:2] + 0.03), start[2]))
    h, g, cons, *_ = program(t, start, currents, stage)
    height, width = STATES + t.rows, t.controls + 1 + STATES
    motion = np.concatenate([cons[k * height : k * height + STATES] for k in range(STEPS)])
    slack = np.zeros((STEPS, len(g)))  # the slack stays at zero because no row needs it
    slack[np.arange(STEPS), np.arange(STEPS) * width + t.controls] = 1.0
    equal = np.vstack([motion, slack])
    zero = np.zeros((len(equal), len(equal)))
    kkt = np.block([[h, equal.T], [equal, zero]])
    found = np.linalg.solve(kkt, np.append(-g, np.zeros(len(equal))))[: len(g)]
    expected = found.reshape(STEPS, width)[:, : t.controls]
    answer = Solver(t).solve(start, currents.T, stage)
    assert np.abs(expected).max() > 0.1
    assert np.abs(currents.T + expected).max() < t.model.max_current.min()
    np.testing.assert_allclose(answer.currents - currents.T, expected, atol=2e-3)


def test_step_with_active_limits_matches_a_reference_solver():
    t = transcription()
    start, currents = a_point(12, t, speed=0.1, amps=0.1)
    start[:3] = 0.0
    limits = (0.3, 0.4, 20.0, 6.0, 1.0, 1.0)
    stage = a_stage(limits=limits, obstacles=[obstacle(0.62, 0.0, 0.2, 0.2)], target=(0.3, 0, 0.4))
    h, g, cons, lower, upper, least, most, *_ = program(t, start, currents, stage)
    dense = ca.conic(
        "dense",
        "qrqp",
        {"h": ca.Sparsity.dense(*h.shape), "a": ca.Sparsity.dense(*cons.shape)},
        {"print_iter": False, "print_header": False, "print_info": False},
    )
    found = dense(h=h, g=g, a=cons, lba=lower, uba=upper, lbx=least, ubx=most)["x"]
    found = np.asarray(found).reshape(STEPS, -1)
    free = np.linalg.norm(np.asarray(cons @ found.ravel())[:, None] - upper, axis=1) < 1e-6
    assert free.sum() > STEPS * STATES  # some limits are active
    answer = Solver(t).solve(start, currents.T, stage)
    moved = answer.currents - currents.T
    np.testing.assert_allclose(moved, found[:, : t.controls], atol=5e-3)
    np.testing.assert_allclose(answer.slack, found[:, t.controls], atol=1e-4)


def test_solution_is_invariant_to_rotation_and_translation():
    t = transcription(steps=8)
    solver, random = Solver(t), np.random.default_rng(13)
    start = np.array([0.1, -0.2, 0.3, 0.2, -0.1, 0.1])
    row = (0.9, 0.15, 0.3, 0.15, 0.4)
    limits = (1.0, 2.0, 20.0, 24.0, 1.0, 3.0)
    target = np.array([1.0, 0.3, 0.8, 0.2, -0.1, 0.1])

    def solved(angle, shift):
        c, s = np.cos(angle), np.sin(angle)
        turn = np.array([[c, -s], [s, c]])
        begin, goal = start.copy(), target.copy()
        for vector in (begin, goal):
            vector[:2] = turn @ vector[:2] + shift
            vector[2] += angle
        goal[3:5] = turn @ goal[3:5]
        place = turn @ row[:2] + shift
        thing = obstacle(*place, *row[2:4], row[4] + angle)
        stage = a_stage(8, limits=limits, obstacles=[thing], box=99.0)
        stage = Stage(**{**vars(stage), "target": np.tile(goal, (8, 1)), "direction": angle})
        return solver.solve(begin, solver.cold(), stage, 6), turn

    plain, _ = solved(0.0, np.zeros(2))
    assert np.abs(plain.states[-1, :2] - start[:2]).max() > 0.05
    for _ in range(4):
        angle, shift = random.uniform(-3, 3), random.uniform(-20, 20, 2)
        other, turn = solved(angle, shift)
        np.testing.assert_allclose(other.currents, plain.currents, atol=2e-3)
        back = (other.states[:, :2] - shift) @ turn
        np.testing.assert_allclose(back, plain.states[:, :2], atol=1e-4)
        np.testing.assert_allclose(other.states[:, 2] - angle, plain.states[:, 2], atol=1e-4)
        np.testing.assert_allclose(other.states[:, 3:], plain.states[:, 3:], atol=1e-3)


# ---- rows against sampled geometry ------------------------------------------------------------


@cache
def rows_at_pose(name="ig42"):
    """Return the rows of a stage at rest, and how many of them the slack does not relax."""
    t = transcription(name, slots=1)
    return t, t.stage_rows


def relaxed_rows(pose, stage, name="ig42"):
    """Return workspace rows (8,) and obstacle rows (2,) of a robot at rest at a pose."""
    t, rows = rows_at_pose(name)
    state = np.append(pose, np.zeros(3))
    value = np.asarray(rows(state, np.zeros(t.controls), stage.table()[0])[0]).ravel()
    return value[t.relaxed : t.relaxed + 8], value[t.relaxed + 8 :]


def depth(pose, half, row):
    """Return the depth of a sampled ellipse in the box [m]; negative if apart."""
    x, y, a, b, angle = row
    r, turn = np.meshgrid(np.linspace(0, 1, 25), np.linspace(0, 2 * np.pi, 90))
    u, v = a * r * np.cos(turn), b * r * np.sin(turn)
    dx, dy = x - pose[0], y - pose[1]
    c, s = np.cos(angle), np.sin(angle)
    px, py = dx + c * u - s * v, dy + s * u + c * v
    c, s = np.cos(pose[2]), np.sin(pose[2])
    body_x, body_y = c * px + s * py, c * py - s * px
    return np.minimum(half[0] - np.abs(body_x), half[1] - np.abs(body_y)).max()


def test_sign_of_obstacle_rows_matches_sampled_shapes():
    random, half = np.random.default_rng(14), model("ig42").half
    clear = cut = 0
    for _ in range(400):
        row = (*random.uniform(-0.9, 0.9, 2), *random.uniform(0.03, 0.8, 2), random.uniform(-3, 3))
        pose = np.append(random.uniform(-0.3, 0.3, 2), random.uniform(-3, 3))
        _, rows = relaxed_rows(pose, a_stage(obstacles=[obstacle(*row)], slots=1))
        gap = true_gaps(np.zeros(1), pose[None], half, ellipses(row)).item()
        if gap > 0.02:
            assert 0.0 < rows.min() < gap + 0.01  # the rows never overestimate the gap
            clear += 1
        elif depth(pose, half, row) > 0.02:
            assert rows.min() < 0.0
            cut += 1
    assert clear > 60 and cut > 60


def test_rows_of_a_box_beside_base_link_are_those_of_its_gap():
    random, met = np.random.default_rng(16), 0
    for _ in range(200):
        box = Rectangles(
            random.uniform(-0.6, 0.6, 2),
            np.array(random.uniform(-3, 3)),
            random.uniform(0.05, 0.5, 2),
        )
        x, y, radius = *random.uniform(-1.2, 1.2, 2), random.uniform(0.05, 0.5)
        row = obstacle(x, y, radius, radius)
        row[8:14] = *box.centre, np.cos(box.yaw), np.sin(box.yaw), *box.half
        pose = np.append(random.uniform(-0.3, 0.3, 2), random.uniform(-3, 3))
        _, rows = relaxed_rows(pose, a_stage(obstacles=[row], slots=1))
        centers, axes = np.array([[[x, y]]]), np.full((1, 1, 2), radius)
        gap = box_gap(pose[None], box, centers, axes, np.zeros(1)).item()
        assert rows.min() == pytest.approx(gap, abs=1e-3)
        met += gap < 0.0
    assert 40 < met < 160


@pytest.mark.parametrize("angle", [0.0, 0.7, -2.0])
def test_obstacle_rows_are_zero_at_contact(angle):
    c, s = np.cos(angle), np.sin(angle)
    pose = np.array([0.3, -0.2, angle])

    def touching(x, y):  # in the frame of the box
        return 0.3 + c * x - s * y, -0.2 + s * x + c * y

    # Contact of an edge with the end of an axis, and of a corner with a circle.
    end = touching(0.4 + 0.5, 0.1)
    _, rows = relaxed_rows(pose, a_stage(obstacles=[obstacle(*end, 0.5, 0.2, angle)], slots=1))
    assert rows.min() == pytest.approx(0.0, abs=1e-4)
    at_corner = touching(-0.4 - 0.3 * np.sqrt(0.5), 0.25 + 0.3 * np.sqrt(0.5))
    _, rows = relaxed_rows(pose, a_stage(obstacles=[obstacle(*at_corner, 0.3, 0.3)], slots=1))
    assert rows.min() == pytest.approx(0.0, abs=1e-4)


def test_obstacle_inside_the_box_violates_rows_towards_the_nearest_edge():
    half = model("ig42").half
    for x, y, way in ((0.3, 0.0, 0), (-0.3, 0.05, 0), (0.0, 0.2, 1), (0.05, -0.2, 1)):
        stage = a_stage(obstacles=[obstacle(x, y, 0.02, 0.02)], slots=1)
        _, here = relaxed_rows(np.zeros(3), stage)
        assert here.min() < -0.02
        # Moving out across that edge reduces the depth: the shortest way out is taken.
        moved = np.zeros(3)
        moved[way] = -0.05 * np.sign((x, y)[way])
        _, there = relaxed_rows(moved, stage)
        assert there.min() - here.min() == pytest.approx(0.05, abs=1e-3)
        out = half[way] + 0.02 - abs((x, y)[way])
        assert -here.min() == pytest.approx(out, abs=1e-3)


def test_box_inside_an_obstacle_violates_its_rows():
    stage = a_stage(obstacles=[obstacle(0.1, 0.1, 3.0, 2.0, 0.3)], slots=1)
    assert relaxed_rows(np.array([0.2, 0.0, 1.0]), stage)[1].min() < -1.0


def test_obstacle_rows_cover_all_corners_in_any_order():
    # Rotated by 90 and 180 degrees, the same obstacle is at another corner or edge.
    row = obstacle(0.45, 0.3, 0.1, 0.1)
    for turned, expected in (
        (0.0, -0.0293),
        (np.pi, -0.0293),
        (0.5 * np.pi, 0.1),
        (-0.5 * np.pi, 0.1),
    ):
        stage = a_stage(obstacles=[row], slots=1)
        found = relaxed_rows(np.array([0.0, 0.0, turned]), stage)[1].min()
        assert found == pytest.approx(expected, abs=1e-3)


def test_workspace_rows_cover_all_four_corners():
    random, half = np.random.default_rng(15), model("ig42").half
    stage = a_stage(slots=1, box=1.0)
    inside = 0
    for _ in range(200):
        pose = random.uniform(-1, 1, 3) * [0.9, 0.9, 4.0]
        points = farthest_points(np.full(STEPS, pose[2]), Rectangles.centred(half))
        rows, _ = relaxed_rows(pose, replace(stage, extremes=points))
        c, s = np.cos(pose[2]), np.sin(pose[2])
        u = np.linspace(-1, 1, 21)
        edge = (
            np.concatenate(
                [np.column_stack([u, 0 * u + e]) for e in (-1, 1)]
                + [np.column_stack([0 * u + e, u]) for e in (-1, 1)]
            )
            * half
        )
        points = pose[:2] + edge @ np.array([[c, s], [-s, c]])
        room = (1.0 - np.abs(points)).min()
        assert (rows.min() > 0.0) == (room > 0.0)
        assert rows.min() == pytest.approx(room, abs=1e-9)
        inside += room > 0.0
    assert 20 < inside < 180


def test_speed_and_acceleration_rows_form_a_polygon_inside_the_circle():
    t, rows = rows_at_pose()
    stage = a_stage(limits=(0.8, WIDE, WIDE, WIDE, WIDE, WIDE), slots=1).table()[0]
    largest = []
    for angle in np.linspace(0, 2 * np.pi, 49):
        state = np.append(np.zeros(3), [0.8 * np.cos(angle), 0.8 * np.sin(angle), 0.0])
        # Currents that hold the speed over the step, so that the row is at this speed.
        value, low, high = (
            np.asarray(part).ravel() for part in rows(state, holding(state), stage)
        )
        used = np.maximum(value / np.where(high > 0, high, 1), value / np.where(low < 0, low, 1))
        largest.append(used[: t.relaxed].max())
    assert min(largest) > 0.995  # nothing outside the circle is allowed
    assert max(largest) < 1.005 / np.cos(
        np.pi / SIDES
    )  # the polygon is up to 3.4 % inside the circle


def holding(state):
    planning = model("ig42")
    twist, amps = ca.SX.sym("twist", 3), ca.SX.sym("amps", 4)
    rate = ca.Function("rate", [twist, amps], [planning.twist_rate(twist, amps)])
    free = np.asarray(rate(state[3:], np.zeros(4))).ravel()
    push = -planning.inertia @ free / (planning.efficiency * planning.emf)
    return np.linalg.pinv(planning.J.T) @ push


def test_program_exists_for_any_number_of_wheels():
    for name in robots.ALL:
        t = transcription(name, steps=2, slots=0)
        start, currents = a_point(16, t)
        h, g, cons, *_ = program(t, start, currents, a_stage(2, slots=0))
        size = 2 * (t.controls + 1 + STATES)
        assert h.shape == (size, size) and g.shape == (size, 1)
        assert cons.shape == (2 * (STATES + t.rows), size)
