"""Planned motions: mechanics, limits, laws, and the planned voltage against the simulation. Meshes are coarse."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import eisbench as eb

pytest.importorskip("casadi")

from eisbench import motion
from eisbench.motion._laws import _error_v

CELL = Path(__file__).parents[2] / "fixtures/data/cells/p45b_25C"
COARSE = motion.Options(flat=4, toe=2, flight=3, landing=4)
ROBOT = motion.Robot()


@pytest.fixture(scope="module")
def model():
    return eb.Model.read(CELL / "model_4rc.json").with_ocv(eb.Ocv.read(CELL / "ocv.json"))


@pytest.fixture(scope="module")
def pack(model):
    return motion.Pack(model, series=16, parallel=3, soc=0.2, interconnect_ohm=0.03)


@pytest.fixture(scope="module")
def free():
    return motion.jump(ROBOT, motion.Free(54.9), COARSE)


@pytest.fixture(scope="module")
def planned(pack):
    return motion.jump(ROBOT, motion.Transient(pack), COARSE)


def rows(found, *phases):
    return np.flatnonzero(np.isin(found.phase, phases))


def test_the_centre_of_mass_flies_ballistically(planned):
    air = rows(planned, "flight")
    since_s = planned.time_s[air] - planned.time_s[air[0]]
    start, speed = planned.com_m[air[0]], planned.com_m_s[air[0]]
    fallen = np.outer(since_s**2, [0, -ROBOT.gravity_m_s2 / 2])
    assert np.abs(planned.com_m[air] - start - np.outer(since_s, speed) - fallen).max() < 1e-3
    # Energy at take-off is that of the highest point.
    assert planned.height_m > 0.5
    rise_m = planned.height_m + ROBOT.standing_m - start[1]
    assert abs(speed[1] ** 2 / 2 - ROBOT.gravity_m_s2 * rise_m) < 1e-6


def between(found):
    """Largest residual force of the motion between its points in the stance, where the solver saw none, N."""
    dynamics, worst = ROBOT.functions()["dynamics"], 0.0
    stance = rows(found, "flat")
    for at in stance[:-2:2]:
        h = found.time_s[at + 2] - found.time_s[at]
        for s in (0.25, 0.75):
            weights = [(1 - s) * (1 - 2 * s), 4 * s * (1 - s), s * (2 * s - 1)]
            a, torque, force = (
                sum(w * column[at + k] for k, w in enumerate(weights))
                for column in (found.a, found.torque_nm, found.force_n)
            )
            q, v = (hermite(x, d, at, h, s) for x, d in ((found.q, found.v), (found.v, found.a)))
            worst = max(worst, np.abs(np.asarray(dynamics(q, v, a, torque, force))).max())
    return worst


def hermite(x, d, at, h, s):
    ends = [
        (1 + 2 * s) * (1 - s) ** 2,
        s * (1 - s) ** 2 * h,
        s**2 * (3 - 2 * s),
        s**2 * (s - 1) * h,
    ]
    return ends[0] * x[at] + ends[1] * d[at] + ends[2] * x[at + 2] + ends[3] * d[at + 2]


def test_dynamics_between_the_points_converge_with_the_mesh():
    # A height that is easy, so that torques have no jumps.
    law = motion.Free()
    coarse, fine = (
        motion.jump_to(ROBOT, law, 0.2, motion.Options(flat=k, toe=k // 2, flight=4))
        for k in (8, 24)
    )
    print(f"{between(coarse):.1f} N, {between(fine):.1f} N")
    assert between(fine) < between(coarse) / 2
    # At the points the equations hold.
    dynamics = ROBOT.functions()["dynamics"]
    for at in range(len(fine.phase)):
        residual = dynamics(
            fine.q[at], fine.v[at], fine.a[at], fine.torque_nm[at], fine.force_n[at]
        )
        assert np.abs(np.asarray(residual)).max() < 1e-3


def test_work_of_the_joints_is_the_energy_of_the_robot():
    fine = motion.jump(ROBOT, motion.Free(), motion.Options(flat=12, toe=6, flight=3))
    stance = slice(0, fine.take_off)
    power_w = fine.joint_w[stance].sum(axis=1)
    work_j = np.sum(np.diff(fine.time_s[stance]) * (power_w[1:] + power_w[:-1]) / 2)
    # Kinetic energy from the mass matrix, whose columns are residuals of unit accelerations.
    dynamics, at = ROBOT.functions()["dynamics"], fine.take_off
    zero = np.zeros(6), np.zeros(6), np.zeros(3), np.zeros(3)
    rest = np.asarray(dynamics(fine.q[at], *zero)).ravel()
    unit = [
        np.asarray(dynamics(fine.q[at], zero[0], e, *zero[2:])).ravel() - rest for e in np.eye(6)
    ]
    kinetic_j = fine.v[at] @ np.array(unit) @ fine.v[at] / 2
    weight_n = ROBOT.mass_kg * ROBOT.gravity_m_s2
    gained_j = kinetic_j + weight_n * (fine.com_m[at, 1] - fine.com_m[0, 1])
    print(f"{work_j:.1f} J, {gained_j:.1f} J")
    assert abs(work_j - gained_j) < 0.01 * gained_j


@pytest.mark.parametrize("which", ["free", "planned"])
def test_limits_hold_at_every_point(which, request):
    found = request.getfixturevalue(which)
    table, small = found.table(), 1e-6
    for k, (name, joint) in enumerate(zip(motion.JOINTS, ROBOT.joints)):
        assert np.abs(found.torque_nm[:, k]).max() <= joint.torque_nm + small
        assert np.abs(table[f"{name}_rad_s"]).max() <= joint.speed_rad_s + 1e-4
        angle = table[f"{name}_rad"]
        assert angle.min() >= joint.low_rad - small and angle.max() <= joint.high_rad + small
        speed = table[f"{name}_rad_s"]
        motor_v = joint.r_ohm * found.motor_a[:, k] + joint.k_nm_per_a * joint.gear * speed
        assert (np.abs(motor_v) <= found.ccv_v + 1e-4).all()
    up_n = found.force_n[:, 1] + found.force_n[:, 2]
    assert (np.abs(found.force_n[:, 0]) <= ROBOT.ground_friction * up_n + 1e-3).all()
    assert (found.force_n[:, 1:] >= -1e-3).all() and not found.force_n[rows(found, "flight")].any()
    heel_m = found.q[:, 1] + ROBOT.foot_m * np.sin(found.q[:, 2])
    assert found.q[:, 1].min() > -small and heel_m.min() > -small
    if which == "planned":
        assert found.margin_low_v.min() >= -small and found.margin_high_v.min() >= -small
    # The motors bind somewhere, else nothing limits the jump.
    shares = np.abs(found.torque_nm) / [joint.torque_nm for joint in ROBOT.joints]
    assert shares.max() > 0.99


def test_power_of_the_bus_is_that_of_motors_and_electronics(planned):
    total_w = planned.motor_w.sum(axis=1) + ROBOT.electronics_w
    assert np.abs(planned.bus_w - total_w).max() < 1e-6
    # Motors take what the joints give, the copper loses and friction takes.
    joints = ROBOT.joints
    copper_w = 2 * planned.motor_a**2 * [joint.r_ohm for joint in joints]
    speeds = np.array([planned.table()[f"{name}_rad_s"] for name in motion.JOINTS]).T
    viscous_w = 2 * speeds**2 * [joint.damping_nm_s for joint in joints]
    lost_w = planned.motor_w - planned.joint_w - copper_w - viscous_w
    assert (lost_w > -1e-6).all()
    assert (lost_w <= 2 * np.abs(speeds) * [joint.friction_nm for joint in joints] + 1e-6).all()
    assert np.abs(planned.current_a * planned.ccv_v - planned.bus_w).max() < 1e-6


def test_no_law_jumps_highest(free, planned, pack):
    simple = motion.jump(ROBOT, motion.SimpleIR(pack), COARSE)
    limited = motion.jump(ROBOT, motion.PowerLimit(2e3, 54.9), COARSE)
    heights_m = [found.height_m for found in (free, planned, simple, limited)]
    print(heights_m)
    assert heights_m[0] > planned.height_m > simple.height_m and heights_m[0] > limited.height_m
    assert limited.bus_w.max() < 2e3 + 1e-3 and free.bus_w.max() > 2e3


def test_the_simulation_of_the_profile_has_the_planned_voltage(planned, pack, tmp_path):
    planned.write_profile(tmp_path / "jump.csv")
    time_s, power_w = np.loadtxt(tmp_path / "jump.csv", delimiter=",", skiprows=1).T
    assert (np.diff(time_s) > 0).all()
    size = {"series": 16, "parallel": 3, "interconnect_ohm": 0.03}
    run = pack.model.simulate(time_s, power_w=power_w, soc=0.2, linear=True, **size)
    apart_v = np.abs(np.interp(planned.time_s, run.time_s, run.ccv_v) - planned.ccv_v).max()
    print(f"{1e3 * apart_v:.1f} mV of {planned.ccv_v.min():.2f} V")
    assert apart_v < 0.05
    assert abs(run.summary["margin_low_v"] - planned.margin_low_v.min()) < 0.005


def test_the_program_reads_the_profile(planned, program, tmp_path):
    planned.write_profile(tmp_path / "jump.csv")
    cell = ["--model", CELL / "model_4rc.json", "--ocv", CELL / "ocv.json", "--soc", "0.2"]
    size = [
        "--series",
        16,
        "--parallel",
        3,
        "--interconnect-ohm",
        0.03,
        "--interpolation",
        "linear",
    ]
    text = program("simulate", *cell, *size, "--profile", tmp_path / "jump.csv", "--json")
    run = json.loads(text)
    assert abs(run["min_ccv_v"] - planned.ccv_v.min()) < 0.05


def test_the_tangent_lets_a_start_beyond_the_most_power_solve(pack):
    start = replace(COARSE, seed=4, reach_w=1000.0)
    found = motion.jump(ROBOT, motion.Transient(pack), start)
    assert found.height_m > 0.5
    with pytest.raises(eb.EisError, match="jump: not solved, Invalid_Number_Detected"):
        motion.jump(ROBOT, motion.Transient(pack, tangent=False), start)
    # Within the reach of the cell it solves without the tangent too.
    start = replace(COARSE, seed=4)
    assert motion.jump(ROBOT, motion.Transient(pack, tangent=False), start).height_m > 0.5


def test_a_weak_pack_limits_by_its_voltage(model):
    weak = motion.Pack(model, series=16, parallel=1, soc=0.1, ageing=1.5)
    found = motion.jump(ROBOT, motion.Transient(weak), COARSE)
    assert -1e-6 < found.margin_low_v.min() < 1e-3
    new = motion.jump(ROBOT, motion.Transient(replace(weak, ageing=1.0)), COARSE)
    assert new.height_m > found.height_m + 0.01


def test_a_height_is_reached_and_a_gap_is_crossed(pack):
    law = motion.Transient(pack)
    up = motion.jump_to(ROBOT, law, 0.3, COARSE)
    assert abs(up.height_m - 0.3) < 1e-6
    over = motion.gap(ROBOT, law, 0.5, COARSE)
    land = rows(over, "landing")
    heel_m = over.q[land, 0] - ROBOT.foot_m
    assert np.abs(heel_m - 0.5).max() < 1e-6 and np.abs(over.v[-1]).max() < 1e-6
    assert np.abs(over.q[-1, 2:] - over.q[0, 2:]).max() < 1e-6
    # The landing takes energy from the robot, never adds some.
    at = land[0]
    assert over.com_m_s[at - 1, 1] < 0 and over.energy_j > 0


def test_a_start_is_followed_and_must_have_the_same_mesh(free, planned, pack):
    from eisbench.motion._tasks import _take_off

    # The variables of a motion that was found satisfy the constraints.
    law = motion.Free(54.9)
    problem, *_ = _take_off(ROBOT, law, replace(COARSE, start=free), "jump", 0.0)
    ca = problem.ca
    met = ca.Function("met", [ca.vertcat(*problem.variables)], [ca.vertcat(*problem.constraints)])
    value = np.asarray(met(problem.start)).ravel()
    assert (value > np.array(problem.g_low) - 1e-3).all()
    assert (value < np.array(problem.g_high) + 1e-3).all()
    # A motion without a cell starts one with a cell.
    law = motion.Transient(pack)
    assert motion.jump(ROBOT, law, replace(COARSE, start=free)).height_m > 0.5
    finer = motion.Options(flat=5, toe=2, flight=3, start=planned)
    with pytest.raises(eb.EisError, match="Options.start: expected a motion with 5 intervals of flat"):
        motion.jump(ROBOT, law, finer)


def test_a_correction_is_added_to_the_planned_voltage(planned, pack):
    added_v = np.full(planned.time_s.size, -0.2)
    law = motion.Transient(pack, correction_v=added_v)
    found = motion.jump(ROBOT, law, replace(COARSE, start=planned))
    time_s, power_w = found.profile()
    size = {"series": 16, "parallel": 3, "interconnect_ohm": 0.03}
    run = pack.model.simulate(time_s, power_w=power_w, soc=0.2, linear=True, **size)
    apart_v = found.ccv_v - np.interp(found.time_s, run.time_s, run.ccv_v)
    assert np.abs(apart_v + 16 * 0.2).max() < 0.05
    lowest_v = found.margin_low_v.min() + pack.window_v[0]
    assert abs(lowest_v - (run.summary["margin_low_v"] + 2.5 - 0.2)) < 0.005
    assert found.height_m < planned.height_m
    with pytest.raises(eb.EisError, match="Transient.correction_v: expected a voltage for each point"):
        motion.jump(ROBOT, motion.Transient(pack, correction_v=added_v[:5]), COARSE)


def mapped(tmp_path, **more):
    def surface(ohm):
        ohms = [[ohm * cold * z for z in (2.0, 1.0, 1.2)] for cold in (2.0, 1.0)]
        return {"activation_j_per_mol": 25e3, "r_ohm": ohms}

    tables = {
        "soc": [0.1, 0.5, 1.0],
        "temperature_degc": [0.0, 25.0],
        "series": surface(7e-3),
        "branches": [{"tau_s": 6e-3, "resistance": surface(3e-3)}],
        "ocv_offset_v": [0.0, 0.0, 0.0],
        "ocv_v_per_k": [0.0, 0.0, 0.0],
        "ocv_temperature_degc": 25.0,
        "thermal": {"capacity_j_per_k": 60.0, "resistance_k_per_w": 6.0},
        **more,
    }
    ocv = {"capacity_ah": 4.5, "soc": [0, 0.5, 1], "ocv_v": [3, 3.7, 4.2], "slope_v": [2, 1.1, 1]}
    file = tmp_path / "map.json"
    file.write_text(
        json.dumps({"name": "map", "r_ohm": 7e-3, "branches": [], "map": tables, "ocv": ocv})
    )
    return motion.Pack(eb.Model.read(file), series=16, parallel=3, soc=0.3)


def test_the_lower_edge_of_the_band_keeps_away_from_the_limit(tmp_path):
    error = {"rest_v": 0.004, "soc": 0.003, "share": [0.08, 0.04], "from": "held_out"}
    weak = mapped(tmp_path, voltage_error={**error, "whole_runs": 1.5})
    weak = replace(weak, parallel=1, soc=0.15, ambient_degc=0.0, interconnect_ohm=0.02)
    bare = motion.jump(ROBOT, motion.Transient(weak), COARSE)
    edge = motion.jump(ROBOT, motion.Transient(weak, sigmas=4 / 3), replace(COARSE, start=bare))
    assert edge.height_m < bare.height_m
    assert -1e-6 < bare.margin_low_v.min() < 1e-3
    # By the formula of the error at the node of 0 °C; the cubic curve has 3.2636 V and a slope of 1.541 V
    # at 15 %.
    rest_v = np.hypot(error["rest_v"], error["soc"] * 1.541)
    loss_v = 3.2636 - (edge.margin_low_v + 2.5)
    half_v = 2.0 * np.hypot(rest_v, error["share"][0] * loss_v)
    # A lower voltage takes more current at the same power of the terminals.
    bus_v = edge.ccv_v / 16
    half_v *= bus_v / (2 * bus_v - 3.2636)
    assert -1e-4 < (edge.margin_low_v - half_v).min() < 1e-3
    with pytest.raises(eb.EisError, match="Transient.sigmas: expected a model with a map that states"):
        motion.jump(ROBOT, motion.Transient(mapped(tmp_path), sigmas=2.0), COARSE)


def test_the_band_of_a_map_grows_with_the_fall_of_its_resistance(tmp_path):
    error = {"rest_v": 0.004, "soc": 0.0, "share": [0.05, 0.05], "from": "held_out"}
    rest_v, share = _error_v(mapped(tmp_path, voltage_error=error))
    assert (rest_v, share) == pytest.approx((0.004, 0.05), rel=1e-6)
    law = {"voltage_v": 0.06, "slowest_s": 3.0}
    fallen = _error_v(mapped(tmp_path, voltage_error=error, charge_transfer=law))
    # 20 % of v − b·tanh(v/b), of a branch of less than a third of the resistance.
    assert fallen[0] == pytest.approx(0.004)
    assert 0.052 < fallen[1] < math.hypot(0.05, 0.2 / 3)


def test_a_diagnosed_model_has_the_band_of_its_held_out_runs(model, tmp_path):
    whole = json.loads(model._model.to_json())
    fields = {"evidence": dict.fromkeys(("held_out_gap_before_v", "held_out_gap_after_v")), "data_set": "d"}
    fields["evidence"] |= {"text": "a test", "lambda": 1.0, "score": 1.0}
    heat = {"name": "g_per_j", "value": 2e-4, "sigma": None, "unit": "1/J"}
    tau = {"name": "tau_s", "value": 600.0, "sigma": None, "unit": "s"}
    named = {"name": "self_heating", "title": "Joule self-heating", "group": "cell"}
    whole["additions"] = [{**named, "parameters": [heat, tau], "added_by": "t", **fields}]
    facts = {"longest_s": 60.0, "shortest_s": 0.1, "greatest_a": 40.0, "widest_soc": 0.1, "soc": 0.5}
    facts |= {"lowest_hz": 0.1, "highest_hz": 300.0, "temperature_c": 25.0, "orders": 0.0, "span_s": 0.0}
    plain = {key: whole[key] for key in ("name", "ocv", "additions")}
    plain["r_ohm"] = model.r_ohm
    plain["branches"] = [{"r_ohm": b.r_ohm, "c_f": b.c_f} for b in model.branches]

    def pack(facts):
        file = tmp_path / "diagnosed.json"
        file.write_text(json.dumps({**plain, "facts": facts}))
        return motion.Pack(eb.Model.read(file), series=16, parallel=3, soc=0.2)

    known = pack({**facts, "held_out": {"runs": 4, "share": 0.05}})
    assert _error_v(known) == pytest.approx((0.001, 0.05))
    bare = motion.jump(ROBOT, motion.Transient(known), COARSE)
    edge = motion.jump(ROBOT, motion.Transient(known, sigmas=1.0), replace(COARSE, start=bare))
    assert edge.height_m < bare.height_m - 0.001
    # The heat of a push-off, in joules, is not bounded as a voltage of 1 V is.
    assert np.abs(bare.state - bare.state[0]).max() > 1.5
    with pytest.raises(eb.EisError, match="walk: expected a model without additions"):
        motion.walk(ROBOT, motion.Transient(known), 0.8)
    with pytest.raises(eb.EisError, match="or with additions and held-out runs, met none"):
        motion.jump(ROBOT, motion.Transient(pack(facts), sigmas=1.0), COARSE)


def test_a_map_at_its_temperature(tmp_path):
    pack = mapped(tmp_path)
    lowest_v = []
    for change in ({}, {"ambient_degc": 5.0}, {"ageing": 1.5}):
        found = motion.jump_to(ROBOT, motion.Transient(replace(pack, **change)), 0.2, COARSE)
        assert abs(found.state[0, 1] - change.get("ambient_degc", 25.0)) < 1e-6
        lowest_v.append(found.ccv_v.min())
    assert lowest_v[0] > lowest_v[1] and lowest_v[0] > lowest_v[2]
    with pytest.raises(
        eb.EisError, match="SimpleIR.r_ohm: expected a resistance for a model with a map"
    ):
        motion.jump(ROBOT, motion.SimpleIR(pack), COARSE)


def test_equal_legs_apart_are_both_as_one():
    rng = np.random.default_rng(3)
    both, apart = ROBOT.mechanics(), ROBOT.mechanics(apart=True)
    q, v, a = rng.uniform(-1, 1, (3, 6))
    torque, force = rng.uniform(-50, 50, 3), rng.uniform(0, 300, 3)
    together = np.asarray(both.functions()["dynamics"](q, v, a, torque, force)).ravel()
    q2, v2, a2 = (np.append(each, each[[4, 3, 2]]) for each in (q, v, a))
    alone = apart.functions()["dynamics"](
        q2, v2, a2, np.append(torque, torque[::-1]), np.append(force / 2, force / 2)
    )
    alone = np.asarray(alone).ravel()
    alone[[2, 3, 4]] += alone[[8, 7, 6]]
    assert np.abs(alone[:6] - together).max() < 1e-9 * np.abs(together).max()
    assert abs(both.mass_kg - apart.mass_kg) < 1e-12
    centres = [np.asarray(m.functions()["com"](*at)[0]) for m, at in ((both, (q, v)), (apart, (q2, v2)))]
    assert np.abs(centres[0] - centres[1]).max() < 1e-12
    with pytest.raises(eb.EisError, match="Robot.legs: expected 2 to walk, met 4"):
        motion.walk(replace(ROBOT, legs=4), motion.Free(), 0.5)


@pytest.mark.parametrize("apart", [False, True])
def test_forces_of_the_ground_act_at_toes_and_heels(apart):
    of = ROBOT.mechanics(apart)
    functions, rng = of.functions(), np.random.default_rng(5)
    q, zeros = rng.uniform(-1, 1, of.size), np.zeros(of.size)
    slack, count = np.zeros(len(of.hinges)), 3 * len(of.feet)

    def residual(force):
        return np.asarray(functions["dynamics"](q, zeros, zeros, slack, force)).ravel()

    # Corner of the drawing and direction of each force; its work is that of the virtual displacement.
    acts = [(1, 0), (1, 1), (0, 1), (9, 0), (9, 1), (10, 1)][:count]
    for k, (corner, axis) in enumerate(acts):
        pulled = residual(np.eye(count)[k]) - residual(np.zeros(count))
        moved = [
            (functions["shape"](q + 1e-6 * e) - functions["shape"](q - 1e-6 * e)) / 2e-6
            for e in np.eye(of.size)
        ]
        expected = [-float(np.asarray(each)[axis, corner]) for each in moved]
        assert np.abs(pulled - expected).max() < 1e-8, (k, corner)


@pytest.fixture(scope="module")
def gait(pack):
    return motion.walk(ROBOT, motion.Transient(pack), 0.8, motion.Options(double=6, single=12))


def test_a_step_ends_as_it_began_with_legs_exchanged(gait):
    foot = gait.mechanics.functions()["foot"]
    toe_m, speed_m_s, _, heel_m = (
        np.stack([np.asarray(row).ravel() for row in each])
        for each in zip(*(foot(*at) for at in zip(gait.q, gait.v, gait.a)))
    )
    double, single = rows(gait, "double"), rows(gait, "single")
    # The rear toe stays where the foot landed a step ago.
    assert np.abs(toe_m[double] - [-gait.step_m, 0]).max() < 1e-4
    assert heel_m[double, 1].min() > -1e-6 and toe_m[single, 1].min() > -1e-4
    assert toe_m[single, 1].max() > ROBOT.clearance_m - 1e-6
    assert abs(gait.step_m / gait.time_s[-1] - 0.8) < 1e-6
    # It lands flat and without impact.
    assert np.abs(speed_m_s[-1]).max() < 1e-6 and abs(gait.v[-1, 8]) < 1e-6
    assert abs(toe_m[-1, 1]) < 1e-6 and abs(heel_m[-1, 1]) < 1e-6
    assert np.abs(gait.q[0, 3:] - gait.q[-1, [7, 6, 5, 4, 3, 2]]).max() < 1e-6
    assert np.abs(gait.v[0, 3:] - gait.v[-1, [7, 6, 5, 4, 3, 2]]).max() < 1e-6
    assert np.abs(gait.torque_nm[0] - gait.torque_nm[-1, ::-1]).max() < 1e-4
    # No foot pulls on the ground or slides.
    for foot_n in (gait.force_n[:, :3], gait.force_n[:, 3:]):
        assert foot_n[:, 1:].min() > -1e-4
        up_n = foot_n[:, 1] + foot_n[:, 2]
        assert (np.abs(foot_n[:, 0]) <= ROBOT.ground_friction * up_n + 1e-3).all()
    assert not gait.force_n[single, 3:].any() and not gait.force_n[double, 5].any()


def test_a_gait_takes_what_its_losses_are(gait):
    # Over a step neither kinetic nor potential energy changes, so that the joints do no work.
    inner = (gait.time_s[2:] - gait.time_s[:-2]) / 6
    power_w = gait.joint_w.sum(axis=1)
    begins = [k for name in ("double", "single") for k in rows(gait, name)[:-2:2]]
    simpson = power_w[:-2] + 4 * power_w[1:-1] + power_w[2:]
    work_j = float(np.sum((inner * simpson)[begins]))
    print(f"{work_j:.3f} J of {gait.energy_j:.1f} J")
    assert abs(work_j) < 0.01 * gait.energy_j
    mean_w = gait.energy_j / gait.time_s[-1]
    assert ROBOT.electronics_w < mean_w < 3 * ROBOT.electronics_w
    assert gait.bus_w == pytest.approx(gait.motor_w.sum(axis=1) + ROBOT.electronics_w, abs=1e-6)


def test_a_long_walk_settles_at_the_planned_voltage(gait, pack, tmp_path):
    steps = 60
    time_s, power_w = gait.profile(steps)
    assert (np.diff(time_s) > 0).all()
    assert time_s[-1] == pytest.approx(steps * gait.time_s[-1], abs=1e-3)
    size = {"series": 16, "parallel": 3, "interconnect_ohm": 0.03}
    run = pack.model.simulate(time_s, power_w=power_w, soc=0.2, linear=True, **size)
    last = time_s > (steps - 1) * gait.time_s[-1]
    # The slowest branch has 5.2 s; the charge has fallen meanwhile.
    fallen_v = run["ocv_v"][0] - run["ocv_v"][-1]
    lowest_v = np.interp(time_s[last], run.time_s, run.ccv_v).min()
    assert abs(lowest_v + fallen_v - gait.ccv_v.min()) < 0.03
    first_v = np.interp(gait.time_s, run.time_s, run.ccv_v).min()
    assert first_v > gait.ccv_v.min() + 0.03, "from rest it is higher"
    gait.write_profile(tmp_path / "walk.csv", steps=3)
    assert len((tmp_path / "walk.csv").read_text().splitlines()) > 3 * len(gait.time_s) - 6


def test_a_faster_gait_takes_more_power_and_a_weak_pack_limits_it(model, pack):
    small = motion.Options(double=3, single=6)
    law = motion.Transient(pack)
    slow, fast = (motion.walk(ROBOT, law, speed, small) for speed in (0.6, 1.6))
    power_w = [found.energy_j / found.time_s[-1] for found in (slow, fast)]
    assert power_w[1] > 1.5 * power_w[0] and fast.ccv_v.min() < slow.ccv_v.min()
    weak = motion.Pack(model, series=16, parallel=1, soc=0.05, ageing=4.0)
    held = motion.walk(ROBOT, motion.Transient(weak), 1.6, small)
    assert -1e-6 < held.margin_low_v.min() < 1e-3, "the cell limits"
    assert held.bus_w.max() < fast.bus_w.max() - 20
    with pytest.raises(eb.EisError, match="walk 9 m/s: not solved"):
        motion.walk(ROBOT, motion.Free(), 9, replace(small, max_iterations=150))
    with pytest.raises(eb.EisError, match="walk: speed_m_s: expected a positive speed"):
        motion.walk(ROBOT, motion.Free(), 0)


def test_a_gait_and_a_jump_say_what_the_other_lacks(gait, planned, tmp_path):
    pytest.importorskip("matplotlib").use("Agg")
    assert f"steps of {gait.step_m:.3f} m" in str(gait)
    with pytest.raises(eb.EisError, match="walk 0.8 m/s: expected a motion with a flight"):
        gait.height_m
    with pytest.raises(eb.EisError, match="jump: expected a gait"):
        planned.step_m
    with pytest.raises(eb.EisError, match="jump: steps: expected 1"):
        planned.profile(2)
    table = gait.table()
    assert table.rows == len(gait.time_s)
    assert "swing_knee_motor_w" in table and "swing_toe_z_n" in table
    gait.animate(tmp_path / "walk.gif", fps=5)
    assert gait.shapes().shape[1:] == (2, 11)


def test_pictures_and_table(planned, tmp_path):
    pytest.importorskip("matplotlib").use("Agg")
    assert planned.plot().get_ylabel() == "power of the bus / kW"
    planned.animate(tmp_path / "jump.gif", fps=5)
    assert (tmp_path / "jump.gif").read_bytes()[:3] == b"GIF"
    table = planned.table()
    assert table.rows == len(planned.time_s) and "knee_motor_w" in table
    assert "law transient" in str(planned)


def test_what_cannot_be_names_the_parameter(model, pack):
    with pytest.raises(eb.EisError, match="Link.mass_kg: expected a positive number, met -1"):
        motion.Link(-1, 0.1, 0.1, 0.1)
    with pytest.raises(
        eb.EisError, match="Robot.ground_friction: expected a positive number, met 0"
    ):
        motion.Robot(ground_friction=0)
    with pytest.raises(eb.EisError, match="Joint.low_rad: expected less than high_rad"):
        replace(ROBOT.knee, low_rad=3.0)
    with pytest.raises(eb.EisError, match="Pack.model: expected an open-circuit voltage"):
        motion.Pack(eb.Model(0.01), 16, 3, 0.5)
    with pytest.raises(eb.EisError, match="Pack.soc: expected 0 to 1, met 1.2"):
        replace(pack, soc=1.2)
    with pytest.raises(eb.EisError, match="Pack.series: expected a whole number from 1, met 0"):
        replace(pack, series=0)
    with pytest.raises(
        eb.EisError, match="law: expected Free, PowerLimit, SimpleIR or Transient, met 'x'"
    ):
        motion.jump(ROBOT, "x")
    with pytest.raises(eb.EisError, match="PowerLimit.limit_w: expected a positive power, met -5"):
        motion.PowerLimit(-5)
    with pytest.raises(eb.EisError, match="gap: length_m: expected a positive length"):
        motion.gap(ROBOT, motion.Free(), 0)
    with pytest.raises(eb.EisError, match="Options.flat: expected a whole number from 1"):
        motion.Options(flat=0)
    with pytest.raises(eb.EisError, match="jump_to 9 m: not solved, .* iterations; ask for less"):
        motion.jump_to(ROBOT, motion.Free(), 9, replace(COARSE, max_iterations=60))


def test_the_example_of_the_page_plans_a_jump(tmp_path, monkeypatch, capsys):
    root = Path(__file__).parents[2]
    text = (root / "docs/motion.md").read_text()
    example = text.split("```python\n")[1].split("```")[0]
    assert len(example.splitlines()) <= 30
    monkeypatch.chdir(tmp_path)
    (tmp_path / "fixtures").symlink_to(root / "fixtures")
    exec(example, {})
    assert float(capsys.readouterr().out) > 0.5 and (tmp_path / "jump.csv").exists()
