"""The inverse problem: known rigs come back, the seed decides, what does not exist is reported as none."""

import math
from dataclasses import replace

import numpy as np
import pytest

from squeal_rig.catalogue.checking import check_file
from squeal_rig.configuration.files import config_directory
from squeal_rig.errors import ModelError, SquealRigError
from squeal_rig.estimation.calibration import (
    Calibration,
    Target,
    Targets,
    calibrate,
    identifiability,
    load_calibration,
    load_targets,
    residual_lines,
    residuals,
    write_preset,
)
from squeal_rig.estimation.calibration.evaluation import Evaluator
from squeal_rig.estimation.calibration.problem import Free
from squeal_rig.model import RigParameters, critical_pad_stiffness, eigenvalues, squeal_frequency
from tests.model.at_rest import critical_stiffness_at_rest, is_threshold_at_rest

CONFIG = config_directory()
PAPER = CONFIG / "paper" / "yavuz_sen_2023.yaml"
CALIBRATION = CONFIG / "calibrations" / "yavuz_sen_2023.yaml"
POINTS = [(27.0, 1.0), (50.0, 1.0), (79.0, 1.0), (200.0, 1.0), (248.0, 1.0), (50.0, 4.0), (128.0, 4.0), (200.0, 4.0)]
STIFFNESSES = (2e7, 4e7, 6e7, 8e7, 10e7)


def targets_of(p: RigParameters) -> Targets:
    """What a rig itself has at the paper's operating points."""
    items = []
    for f, v in POINTS:
        k = critical_pad_stiffness(p.replace(preload=f, belt_speed=v))
        items.append(Target("critical_pad_stiffness", f, v, k, k))
    for k in STIFFNESSES:
        at = p.replace(preload=300.0, belt_speed=1.0, pad_stiffness=k)
        items.append(Target("squeal_frequency", 300.0, 1.0, k, squeal_frequency(eigenvalues(at, linear=True))))
    return Targets("itself", tuple(items))


def test_a_known_rig_comes_back_from_its_own_thresholds_and_frequencies():
    p = RigParameters().replace(mass=9.3, contact_stiffness=5.9e8, k3=2.05e8, k4=2.05e8)
    # Its friction reaches 0.80044 at (300 N, 1 m/s): the demand must hold it.
    problem = Calibration.of(targets_of(p))
    found = calibrate(replace(problem, friction=replace(problem.friction, upper=0.9)), seed=3, starts=2)
    assert found.missing == 0
    # The polish ends where errors are of the order of their differences' rounding, 1e-9; singular values span 1e3.
    assert found.loss < 1e-6
    for name in ("mass", "contact_stiffness", "k3", "k4", "mu0", "mu_preload"):
        assert getattr(found.rig, name) == pytest.approx(getattr(p, name), rel=1e-3), name


def test_the_seed_decides_and_another_one_starts_elsewhere():
    problem = Calibration.of(load_targets(PAPER))
    first, again, other = (calibrate(problem, seed, starts=1, generations=40) for seed in (5, 5, 6))
    assert first.rig == again.rig
    assert first.starts == again.starts
    assert first.near.shape == again.near.shape
    assert other.rig != first.rig


def test_thresholds_alone_say_nothing_of_mass_and_scale():
    problem = Calibration.of(load_targets(PAPER))
    found = calibrate(replace(problem, weights={"critical_pad_stiffness": 1.0}), seed=1, starts=1, generations=300)
    known = identifiability(found)
    # Eight thresholds see D and the four terms of mu k_c: of mass, k_c, k3 and four terms five combinations.
    assert np.sum(known.singular_values < 1e-6 * known.singular_values[0]) == 2
    mass = known.names.index("mass")
    assert np.linalg.norm(known.directions[-2:, mass]) == pytest.approx(1.0, abs=1e-6)
    assert "mass" in known.wide


@pytest.mark.slow
def test_a_root_that_cannot_exist_is_reported_as_none(tmp_path):
    # Mirrored arms: no mode coupling, whatever else is free.
    problem = Calibration.of(load_targets(PAPER))
    mirrored = replace(problem, base=RigParameters.preset("yavuz_sen_2023_as_printed"))
    found = calibrate(mirrored, seed=1, starts=1, generations=20)
    assert found.missing == 8 + 5
    assert math.isinf(found.loss)
    thresholds = [item for item in residuals(mirrored, found.rig) if item.target.kind == "critical_pad_stiffness"]
    assert all(math.isnan(item.computed) and math.isnan(item.error) for item in thresholds)
    assert residual_lines(thresholds)[-1] == "critical_pad_stiffness: none"
    assert sum("none" in line.split() for line in residual_lines(thresholds)[:-1]) == 8
    write_preset(found, tmp_path / "none.yaml", "a test")
    text = (tmp_path / "none.yaml").read_text()
    assert "13 roots that the targets ask for do not exist: this is no fit" in text
    assert check_file(tmp_path / "none.yaml") == "rig parameters"


def test_fewer_missing_roots_rank_first_whatever_the_loss():
    problem = Calibration.of(load_targets(PAPER))
    evaluator = Evaluator(problem)
    judged = evaluator.of(np.random.default_rng(2).random((400, evaluator.size)))
    order = judged.order()
    assert len(set(judged.missing)) > 3
    assert (np.diff(judged.missing[order]) >= 0).all()
    assert np.isinf(judged.loss[judged.missing > 0]).all()
    whole = order[judged.missing[order] == 0]
    assert (np.diff(judged.loss[whole]) >= 0).all()


def test_the_threshold_at_the_true_equilibrium_is_one_of_the_exact_eigenvalues():
    for changes in ({}, {"preload_direction": "arms"}, {"arm_length_1": 0.01, "pretension_length": 1e-3}):
        p = RigParameters().replace(preload=200.0, belt_speed=4.0, **changes)
        k = critical_stiffness_at_rest(p)
        assert is_threshold_at_rest(p, k, 1e-4), changes
    # Arms of 0.1 m turned by 1e-5 m change a stiffness by about 1e-4; near the edge of flutter k_cr moves more.
    p = RigParameters()
    assert critical_stiffness_at_rest(p) == pytest.approx(critical_pad_stiffness(p), rel=2e-3)
    assert math.isnan(critical_stiffness_at_rest(RigParameters.preset("yavuz_sen_2023_as_printed")))


def test_contact_loss_and_nonlinear_frequency_can_be_targets():
    problem = Calibration.of(load_targets(PAPER))
    weights = {"critical_pad_stiffness": 1.0, "contact_loss": 1.0, "nonlinear_frequency": 1.0}
    simulated = replace(problem, weights=weights, simulation=replace(problem.simulation, settle=0.5, duration=0.1))
    p = RigParameters().replace(damping_x=60.0, damping_y=60.0, mu_preload=2.3e-3)
    judged = Evaluator(simulated).of_rig(p)
    # docs/physics.md: from small starts with damping the shares rise from 0.54 to 0.59, at 0.83 to 0.85 of the linear.
    assert judged.computed["contact_loss"][0] == pytest.approx(
        [0.545, 0.570, 0.582, 0.587, 0.589], abs=0.03
    )  # the settled shares; a short run from rest is still some hundredths off
    assert judged.computed["nonlinear_frequency"][0] == pytest.approx([959, 961, 974, 991, 1011], rel=0.02)
    assert judged.missing[0] == 0
    assert np.isfinite(judged.loss[0])


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("critical_pad_stiffness: [{preload: 50, belt_speed: 1}]", "row 1: k_cr is missing"),
        (
            "critical_pad_stiffness: [{preload: -5, belt_speed: 1, k_cr: 5e7}]",
            "row 1: preload = -5 N is out of bounds: it must be 0 to 2000 N",
        ),
        ("critical_pad_stiffness: [{preload: 5, belt_speed: fast, k_cr: 5e7}]", "belt_speed = 'fast' must be a number"),
        ("critical_pad_stiffness: [{preload: 5, belt_speed: 1, k_cr: .nan}]", "k_cr = nan N/m is out of bounds"),
        (
            f"critical_pad_stiffness: [{{preload: 5, belt_speed: 1{'0' * 400}, k_cr: 1e7}}]",
            "belt_speed = inf m/s is out of bounds: it must be 0 to 20 m/s",
        ),
        ("critical_pad_stiffness: 3", "expected a list, got 3"),
        ("critical_pad_stiffness: []", "there is no target in it"),
        ("squeal_frequency: {preload: 300}", "squeal_frequency: belt_speed is missing"),
        ("peak_displacement_jump: [{k: 2e7, belt_speed: 1}]", "row 1: jump_preload is missing"),
        ("critical_pad_stiffness: []\nsqueel: 3", "unknown section 'squeel'"),
        ("free: {mass: {lower: 1, upper: 2}}", "targets is missing"),
        ("targets: PAPER\nfree: {}", "no parameter is free"),
        ("targets: PAPER\nfree: {mas: {lower: 1, upper: 2}}", "unknown parameter 'mas': did you mean 'mass'?"),
        ("targets: PAPER\nfree: {mass: {lower: 3, upper: 2}}", "mass: bounds 3 to 2 must rise"),
        ("targets: PAPER\nfree: {preload: {lower: 3, upper: 20}}", "preload is set by the targets"),
        ("targets: PAPER\nfree: {friction_speed: }", "friction_speed is a choice of words: it cannot be free"),
        ("targets: PAPER\nfree: {mass: }\ntied: {k4: k3}", "must tie a parameter that is not free to one that is"),
        ("targets: PAPER\nfree: {mass: }\ntied: {k4: {a: 1}}", "must tie a parameter that is not free to one that is"),
        ("targets: PAPER\nfree: {mass: }\nweights: {mass: 1}", "weights: unknown key 'mass'"),
        ("targets: PAPER\nfree: {mass: }\nweights: {squeal_frequency: 0}", "every weight is zero"),
        ("targets: PAPER\nfree: {mass: }\nmeasure: median", "measure = 'median' is not known: it must be one of rms"),
        ("targets: PAPER\nfree: {mass: }\nfriction: {lower: 0.9}", "lower = 0.9 must be below upper = 0.8"),
        ("targets: PAPER\nfree: {mass: }\nfriction: {preload: 5}", "preload = 5 must be two numbers"),
        ("targets: PAPER\nfree: {mass: }\npreset: nobody", "no preset 'nobody'"),
        ("targets: nowhere.yaml\nfree: {mass: }", "cannot read"),
    ],
)
def test_a_bad_file_is_refused_with_a_sentence(tmp_path, text, sentence):
    path = tmp_path / "calibration.yaml"
    path.write_text(text.replace("PAPER", str(PAPER)))
    with pytest.raises(SquealRigError) as refused:
        check_file(path)
    assert sentence in str(refused.value)
    assert "\n" not in str(refused.value)


def test_free_parameters_can_be_named_on_the_command_line():
    problem = load_calibration(CALIBRATION)
    names = [item.name for item in problem.with_free(["mass", "k3=1e8:4e8", "arm_angle_1=2:3"]).free]
    assert names == ["mass", "k3", "arm_angle_1"]
    assert problem.with_free(["mass"]).tied == {}
    for text, sentence in (("mas", "did you mean 'mass'"), ("k3=5", "write name, or name=lower:upper")):
        with pytest.raises(SquealRigError, match=sentence):
            problem.with_free([text])


def test_an_optimum_on_a_declared_bound_is_written_and_explained(tmp_path):
    problem = replace(
        Calibration.of(targets_of(RigParameters())),
        free=(Free("damping_x", 0.0, 1e-3), Free("mu0", 0.2, 0.3)),
        tied={"damping_y": "damping_x"},
    )
    found = calibrate(problem, seed=1, starts=1, generations=20)
    at_bound = replace(found, rig=found.rig.replace(damping_x=0.0, damping_y=0.0))
    assert np.isfinite(identifiability(at_bound).singular_values).all()
    highest = replace(found, rig=found.rig.replace(mass=1e5), problem=replace(problem, free=(Free("mass", 1.0, 1e5),)))
    assert np.isfinite(identifiability(replace(highest, near=np.ones((1, 1)))).singular_values).all()
    write_preset(at_bound, tmp_path / "bound.yaml", "test")
    assert RigParameters.from_yaml(tmp_path / "bound.yaml").damping_x == 0.0


def test_no_start_is_refused():
    with pytest.raises(ModelError, match="starts = 0"):
        calibrate(Calibration.of(load_targets(PAPER)), starts=0)
