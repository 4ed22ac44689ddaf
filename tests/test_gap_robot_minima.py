"""Fit of all effects of a robot from several starts, rivals by their likelihood, constants of a servo. Logs are *synthetic*."""

from types import SimpleNamespace

import numpy as np
import pytest
from robot_arm import ARM, edited, write_logs
from test_gap_robot import SERVO, records_of

from fishmj import effects
from fishmj.gap.decide.decide import near_in_likelihood
from fishmj.gap.models.rigid_robot import RigidRobot
from fishmj.gap.models.robot_description import read_robot
from fishmj.gap.models.robot_sizes import RobotSizes, sizes_of
from fishmj.gap.null.robot_null import RobotNull
from fishmj.gap.null.variances import VarianceScore
from fishmj.gap.null.whitening import record_whitening
from fishmj.gap.records.records import ResidualLayout
from fishmj.gap.search import unexplained_torque
from fishmj.gap.search.fit import bounds
from fishmj.gap.search.likelihood import Likelihood
from fishmj.gap.search.unexplained_torque import TorqueFit, descend, torques, with_measured_errors
from fishmj.gap.thresholds import thresholds

pytest.importorskip("numba")
SOME = ("coulomb_friction", "viscous_friction", "torque_offset", "rotor_inertia", "com_offset")


@pytest.fixture(scope="module")
def question(tmp_path_factory):
    """(model, records, null, likelihood before any fit) of an arm with dry friction at its elbow."""
    folder = tmp_path_factory.mktemp("minima")
    (folder / "arm.xml").write_text(ARM)
    arm = read_robot(folder / "arm.xml")
    records = records_of(arm, write_logs(folder / "sticky", edited(elbow_joint='frictionloss="0.06"'), logs=2, seconds=2.6))
    null, catalogue = RobotNull(16), [effects.robot_catalogue()[name] for name in SOME]
    model = RigidRobot(arm, sizes_of(arm, records), catalogue)
    wide = model.with_errors(thresholds().torques.start * model.torque_tolerance, model.null)
    return model, records, null, Likelihood(wide, records, null.residuals(model, records, ResidualLayout(records)))


def test_rounds_of_the_fit_never_get_less_likely(question):
    model, *_, e = question
    fits = [TorqueFit(np.inf, e, model.null)]
    for _ in range(4):
        fits.append(descend(fits[-1], 1, 3))
    assert all(after.loss <= before.loss for before, after in zip(fits[:-1], fits[1:], strict=True))
    assert fits[1].loss - fits[-1].loss > thresholds().torques.settled


def test_kept_fit_is_no_worse_than_from_any_start(question):
    """Starts drawn within a third of the usual sizes, and none at all, end at the noise that is kept, or at more."""
    model, records, null, e = question
    low, high, size = bounds(model)
    rng, first = np.random.default_rng(2), len(model.constants)
    chosen, found = with_measured_errors(model, records, null)
    kept = e.with_record_errors(chosen)
    least = kept.subset().loss(chosen.reference)
    assert found.least == pytest.approx(torques(kept, chosen.reference), rel=0.2)
    for k in range(3):
        start = model.null
        start[first:] += k * 0.15 * size[first:] * rng.standard_normal(len(start) - first)
        fit = descend(TorqueFit(np.inf, e, np.clip(start, low, high)), 6, 3)
        assert least < fit.loss + 0.02 * abs(fit.loss)


@pytest.mark.parametrize("expected, factor", [(-1.0, 1.0), (1e-200, 1e3)])
def test_torques_stay_finite_where_no_torque_is_large_enough(question, monkeypatch, expected, factor):
    """A joint that sticks, in a model that slides: the size overflowed on logs of a measured servo."""
    model, *_, e = question
    sums = VarianceScore(0.0, 1.0, np.full(model.joints + 1, 1e9), np.full(model.joints + 1, expected))
    monkeypatch.setattr(unexplained_torque, "score_variances", lambda *_: sums)
    np.testing.assert_allclose(torques(e, model.null), factor * e.model.torque_error)


def test_candidates_as_likely_as_the_best_are_rivals_of_a_robot():
    at = lambda name, cost: SimpleNamespace(names=("payload@b1", name), newest=(name,), cost=cost)
    lead = thresholds().torques.lead
    ranked = (at("payload@b2", 10.0), at("com_offset@b2", 10.0 + 0.9 * lead), at("body_mass@b2", 10.0 + 1.1 * lead))
    steps = [SimpleNamespace(accepted=True, ranked=ranked), SimpleNamespace(accepted=False, ranked=ranked[::-1])]
    robot, fish = object.__new__(RigidRobot), SimpleNamespace()
    robot.joints, robot.active = 2, SimpleNamespace(effects=())
    found = lambda model: SimpleNamespace(near=SimpleNamespace(model=model), steps=steps)
    assert near_in_likelihood(found(robot), "payload@b2") == {"com_offset@b2"}
    assert near_in_likelihood(found(robot), "body_mass@b2") == set()
    assert near_in_likelihood(found(fish), "payload@b2") == set()


def test_factors_that_share_no_sample_whiten_as_all_of_them_at_once():
    """Errors of four segments whose samples are not in a row, then five factors across all of them."""
    rng, m = np.random.default_rng(0), 60
    factors = np.concatenate([np.zeros((24, m)), rng.standard_normal((5, m))])
    for segment in range(4):
        factors[6 * segment : 6 * segment + 6, segment::4] = rng.standard_normal((6, m // 4))
    d = rng.uniform(0.5, 2.0, m)
    found = record_whitening(d, [factors], np.zeros(m, int))
    assert [u.shape for _, u, _ in found.parts] == [(15, 6)] * 4 + [(60, 5)]
    white, whole = found(np.eye(m)).T, np.diag(d**2) + factors.T @ factors
    np.testing.assert_allclose(white @ whole @ white.T, np.eye(m), atol=1e-12)
    assert found.logdet == pytest.approx(np.linalg.slogdet(whole)[1])


def test_controllers_damping_is_no_better_known_than_its_gain(tmp_path):
    """A ratio of both that is a per cent off was named on a healthy robot."""
    path = tmp_path / "servo.xml"
    path.write_text(SERVO)
    robot = read_robot(path)
    model = RigidRobot(robot, RobotSizes(*np.ones((4, 1))))
    sigma = {c.name: c.sigma for c in model.constants}
    assert sigma["damping_gain@hip"] == sigma["gain@hip"] > 0.0
    row = model.null
    row[list(sigma).index("damping_gain@hip")] = 1.1
    np.testing.assert_allclose(model.model(row).actuator_biasprm[0, :3], (0.0, -8.0, -0.33))
    assert "damping_gain@elbow" not in {c.name for c in arm_constants(tmp_path)}


def arm_constants(folder):
    """Constants of the arm, whose motors have no controller."""
    (folder / "arm.xml").write_text(ARM)
    return RigidRobot(read_robot(folder / "arm.xml"), RobotSizes(*np.ones((4, 2)))).constants
