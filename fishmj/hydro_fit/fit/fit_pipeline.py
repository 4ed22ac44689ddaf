"""The whole fit, stage by stage: each stage is kept when done, so an interrupted fit resumes.

    linear     least squares on wrenches                               rollout   factors by free swims
    residual   remaining forces                                        swims     the residual again, by free swims
    retune     the factors again, with the residual in place           finish    members, range and error bar
A stage that makes the validation swims worse is not used; the notes record that. The test part is never read.
"""

import hashlib
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np

from fishmj.base import interrupt
from fishmj.base.errors import DatasetError, StoreError
from fishmj.base.store import json_sha256, plain, read_tensors, write_tensors
from fishmj.hydro_fit.fit import force_training, gauss_newton, linear_regression, prediction_interval, rollout, training_windows
from fishmj.hydro_fit.fit import rollout_training as swims
from fishmj.hydro_fit.fit.regression_rows import RegressionRows, rows_of
from fishmj.hydro_fit.fit.training_loop import Loop
from fishmj.hydro_fit.record import SegmentRecord
from fishmj.mjcf.description import Robot
from fishmj.mjcf.identity import body_sha256
from fishmj.water import residual_hooks
from fishmj.water import residual_network as residual
from fishmj.water.dynamics import planar_chain
from fishmj.water.hydro_model import HydroModel, robot_hash
from fishmj.water.prior import flat, prior_of, unflat

STAGES = ("linear", "rollout", "residual", "swims", "retune", "finish")
SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)  # of a given residual that are tried
TYPICAL = dict(zip(STAGES, (4.0, 25.0, 12.0, 204.0, 17.0, 30.0), strict=True))  # s, of 1000 swims on 16 cores; for the bar alone
PACKAGE = Path(__file__).parents[2]
ROOMS = ("water/dynamics", "water", "hydro_fit", "hydro_fit/fit")
QUIET = {"__main__.py", "fit_report.py", "online_correction.py"}  # what only asks or tells


@cache
def code(*more: str) -> str:
    """sha256 of all code that computes a fit and its figures, and of the rooms `more`.

    A stage that other code finished is not reused.
    """
    files = [path for room in (*ROOMS, *more) for path in sorted((PACKAGE / room).glob("*.py")) if path.name not in QUIET]
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()


@dataclass(frozen=True)
class FitSettings:
    """Settings of a fit.

    steps, swims: numbers of learning steps by forces and by free swims.
    swim: seconds of free swimming at most in each Gauss-Newton batch.
    """

    seed: int = 0
    members: int = 5
    hidden: int = 16
    steps: int = 400
    swims: int = 1000
    swim: float = 600.0
    residual: bool = True
    memory: bool = True
    products: bool = True
    rollout: bool = True


Report = Callable[[str, float, dict], None]  # stage, share of the whole fit, figures: none where it begins, by compiling


def quiet(stage: str, share: float, figures: dict) -> None:
    """Prints nothing."""


def learnt_of(state: dict) -> residual_hooks.Residual | None:
    """Residual of a state, or None."""
    return residual_hooks.unpacked(state) if "net.reach" in state else None


class FitPipeline:
    """One fit of one robot.

    Args:
        train, val: records at one slip ratio. folder: folder of finished stages; None keeps nothing.
        dataset: sha256 and further metadata of the data.
        given: a learnt residual that is kept as it is; the fit chooses its share (the coefficient `residual`) and the strips.
    Raises:
        DatasetError: a part is empty or has no free swim.
    """

    def __init__(
        self, robot: Robot, train: Sequence[SegmentRecord], val: Sequence[SegmentRecord], *, dataset: dict,
        settings: FitSettings | None = None, folder: Path | None = None, report: Report = quiet,
        given: residual_hooks.Residual | None = None,
    ):  # fmt: skip
        if not train or not val:
            raise DatasetError(f"fit: {len(train)} training and {len(val)} validation records; both parts are needed")
        self.robot, self.chain, self.folder, self.report = robot, planar_chain.chain_of(robot), folder, report
        self.given = given
        self.train, self.val, self.dataset, self.settings = list(train), list(val), dataset, settings or FitSettings()
        self.force_records = [r for r in self.train if r.meta["block"] != gauss_newton.PUSHED]  # whose forces tell, row by row
        self.tick = self.train[0].tick
        self.swim = rollout.SwimWindow(self.chain, planar_chain.nominal(robot))
        self.limits = prior_of(robot)
        prior = {key: np.asarray(value).tolist() for key, value in vars(self.limits).items()}
        self.about: dict[str, Any] = {"robot": robot_hash(robot), "prior": prior, "data": dataset, "code": code()}
        self.about["water"] = flat(planar_chain.nominal(robot).water).tolist()
        self.about["records"] = [r.id for r in [*self.train, *self.val]]
        if given is not None:
            self.about["given"] = residual_hooks.sha256(given)
        # all inputs of the result: a kept stage is reused only if they are all the same
        depends = self.about | {"settings": asdict(self.settings)}
        self.key = json_sha256(plain(depends))
        self.notes: list[str] = []
        self.found: dict[str, dict] = {}
        self.seconds: dict[str, float] = {}
        self.done: list[str] = []  # stages of this fit that are kept
        self.loop = Loop()  # of the stage that is under way

    def run(self) -> HydroModel:
        """Runs all stages; returns the model."""
        return self._model(self.run_stages(STAGES))

    def run_stages(
        self, stages: Iterable[str], clock: Callable[[], float] = time.perf_counter, state: dict[str, Any] | None = None
    ) -> dict[str, Any]:
        """State after the stages, each read if it is kept and else run; `clock` times them, they begin with `state`."""
        state = dict(state or {})
        for stage in stages:
            self.begin_stage(stage)
            kept = self._read(stage)
            if kept is None:
                self.report(stage, self._share(stage, 0.0), {})
                path, began = self._path(stage), clock()
                self.loop = Loop(path and path.with_name(f"loop-{path.name}"), self.key)
                state |= getattr(self, f"_{stage}")(state)
                self.seconds[stage] = clock() - began
                self._write(stage, state)
                self.loop.end()
            else:
                state = kept
            self.done.append(stage)
            self.report(stage, self._share(stage, 1.0), {"seconds": self.seconds.get(stage, 0.0)})
        return state

    def kept_so_far(self) -> str:
        """Keeps the present state of the running stage; returns a text about it.

        For `interrupt.keeping`: called in another thread.
        """
        self.loop.save()
        if self.folder is None:
            return "nothing of it is kept"
        return f"{self.folder} holds the stages {', '.join(self.done) or 'begun'}; {interrupt.again()}"

    def begin_stage(self, stage: str) -> None:
        """Called before each stage; a fit whose stages have keys of their own sets `key` here."""

    # stages: state -> additions to it

    def _linear(self, state) -> dict:
        rows = rows_of(self.chain, self.force_records)
        done = linear_regression.fit_linear(self.robot, self.chain, rows, self.tick)
        self.found["linear"] = done.found.table()
        return {"water": flat(done.water), "noise": done.noise}

    def _rollout(self, state) -> dict:
        if not self.settings.rollout:
            return self._unmoved(state)
        return self._gauss_newton(state, None, "rollout")

    def _gauss_newton(self, state, learnt, stage: str) -> dict:
        before = self.score(state["water"], learnt)
        report = lambda k, n, cost: self._report(stage, k / n, cost=cost)
        match, start = self._match(self.train, learnt), unflat(state["water"])
        done = gauss_newton.fit_rollout(self.robot, self.chain, match, start, report=report, loop=self.loop)
        # on swims outside Gauss-Newton's data: it may fit the noise of the training swims, or diverge
        after = self.score(flat(done.water), learnt)
        if after > before:
            self.notes.append(f"{stage}: not taken, validation {before:.4g} -> {after:.4g}")
            if learnt is not None:
                return {}
            # the factors stay, and are as uncertain as the swims and the prior leave them there
            done = gauss_newton.fit_rollout(self.robot, self.chain, match, start, rounds=0)
        else:
            self.found[stage] = done.found.table()
        factors = self._drawn(done.jacobian)
        new = {"water": flat(done.water), "factors": factors}
        return new if learnt is not None else new | {"alone": new["water"], "alone_factors": factors}

    def _drawn(self, jacobian: np.ndarray) -> np.ndarray:
        """Factors (E, S) of the error bar's members: draws from the Laplace approximation N(0, (J^T J + prior)^-1)."""
        normal = jacobian.T @ jacobian + np.eye(jacobian.shape[1]) / gauss_newton.SPREAD**2
        draws = np.random.default_rng([53, self.settings.seed]).standard_normal((self.settings.members, len(normal)))
        return np.linalg.solve(np.linalg.cholesky(normal).T, draws.T).T

    def _unmoved(self, state) -> dict:
        still = np.zeros((self.settings.members, len(gauss_newton.groups(self.chain.n))))
        return {"factors": still, "alone": state["water"], "alone_factors": still}

    def _residual(self, state) -> dict:
        s = self.settings
        if self.given is not None:
            return self._with_share(state["water"], self.given)
        if not s.residual:
            return {}
        report = lambda k, n, cost: self._report("residual", k / n, loss=cost)
        net = residual.blank(self.chain.n, s.members, s.hidden, seed=s.seed)
        windows = self._training_windows(state["water"])
        net = force_training.learn(
            self.chain, windows, net, steps=s.steps, seed=s.seed, ablated=self._ablated, report=report, loop=self.loop
        ).net
        return residual_hooks.packed(self._with_range(net, state["water"]))

    def _with_share(self, water: np.ndarray, learnt: residual_hooks.Residual) -> dict:
        """State with a residual of which the share acts that swims best on the validation part."""
        waters = [flat(unflat(water.tolist())._replace(residual=share)) for share in SHARES]
        scores = [self.score(row, learnt) for row in waters]
        best = int(np.argmin(scores))
        tried = ", ".join(f"{share:g}: {score:.4g}" for share, score in zip(SHARES, scores, strict=True))
        self.notes.append(f"residual: given; validation swims by its share: {tried}")
        return {"water": waters[best], **residual_hooks.packed(learnt)}

    def _swims(self, state) -> dict:
        learnt, water = learnt_of(state), state["water"]
        if learnt is None or self.given is not None or not self.settings.swims:
            return {}
        s, c = self.settings, unflat(water.tolist())
        windows = self._training_windows(water)
        tethered = swims.tethered_of(self.chain, self.train, c)
        pieces = swims.windows_of(self.chain, self.robot, self.train, c)
        report = lambda k, n, cost: self._report("swims", k / n, loss=cost)
        trainer = swims.RolloutTrainer(self.robot, self.swim, pieces, tethered, windows, water, ablated=self._ablated)
        net = trainer.learn(learnt.net, steps=s.swims, seed=s.seed, report=report, loop=self.loop)
        return residual_hooks.packed(self._with_range(net, water))

    @property
    def _ablated(self) -> dict:
        return {"memory": self.settings.memory, "products": self.settings.products}

    def _with_range(self, net: residual.Net, water) -> residual_hooks.Residual:
        """Net with the range of its training data, and a note on how it swims."""
        rows = rows_of(self.chain, self.force_records)
        reach = self._range(*training_windows.features(self.chain, rows))
        spread = training_windows.warm_up(
            self.chain, rows, unflat(water.tolist()), residual_hooks.Residual(net, reach), self.tick
        ).spread
        # three times the typical disagreement of the members halves the force: outside the data members disagree first
        learnt = residual_hooks.Residual(net, reach._replace(spread=np.array(3.0 * np.sqrt(spread.mean()) + 1e-6)))
        before, after = self.score(water, None), self.score(water, learnt)
        self.notes.append(f"residual: validation swims {before:.4g} -> {after:.4g}")
        return learnt

    def _range(self, xi: np.ndarray, speed: np.ndarray) -> residual_hooks.MotionRange:
        """Range of the data, `xi` (M, N, 5) and `speed` (M, N) of `training_windows.features`; `_with_range` sets its spread."""
        return residual_hooks.fitted(xi, speed, 1e6)

    def _retune(self, state) -> dict:
        learnt = learnt_of(state)
        return {} if learnt is None or not self.settings.rollout else self._gauss_newton(state, learnt, "retune")

    def _finish(self, state) -> dict:
        learnt, water = learnt_of(state), state["water"]
        if learnt is not None:
            alone, both = self.score(state["alone"], None), self.score(water, learnt)
            self.notes.append(f"validation swims, in squared tolerances: base {alone:.4g}, with residual {both:.4g}")
            # the strips alone were fitted for this case; the residual is used only if it improves the swims
            if alone < both:
                self.notes.append("the residual is not taken")
                if self.given is None:
                    learnt, water = None, state["alone"]
                else:
                    water = flat(unflat(state["alone"].tolist())._replace(residual=0.0))
                state = {**state, "factors": state["alone_factors"]}
        swims = [r for r in [*self.train, *self.val] if rollout.is_free(r)]
        fleet = rollout.fish_batch_of(self.chain, self.robot, swims, seconds=1e6)
        members, bands = [], []
        for w, factors, r in ((water, state["factors"], learnt), (state["alone"], state["alone_factors"], None)):
            waters = np.stack([gauss_newton.scaled(w, row, self.chain.n, self.limits) for row in factors])
            made = self._band(fleet, w, waters, r)
            members.append(waters)
            bands.append([made[channel] for channel in prediction_interval.CHANNELS])
        kept = {"members": members[0], "alone_members": members[1], "bands": np.array(bands), "water": water}
        return kept | {"taken": np.array(learnt is not None)}

    def _band(self, fleet, water, waters, learnt) -> dict[str, list[float]]:
        parts = prediction_interval.of_members(self.swim, fleet, waters, learnt)
        trained = np.array([number < sum(map(rollout.is_free, self.train)) for number, _ in fleet.source])
        tracks = (self.swim.run(fleet, water, learnt), rollout.recorded(fleet))
        mean, seen = (prediction_interval.means(track, fleet) for track in tracks)
        return prediction_interval.fit_band(mean, parts, seen, trained)

    # common to all stages

    def score(self, water: np.ndarray, learnt) -> float:
        """Mean squared error of the validation swims, in tolerances."""
        return self.score_of(self._validation, water, learnt)

    def score_of(self, match: gauss_newton.Match, water: np.ndarray, learnt) -> float:
        """Mean squared error of some of the validation swims, in tolerances."""
        match.learnt = learnt
        error = match.residuals(np.asarray(water)[None])[0]
        return float(error @ error / len(error) * match.recorded_windows.surge.shape[1])

    @cached_property
    def _validation(self) -> gauss_newton.Match:
        return self._match(self.val, None)

    def _training_windows(self, water: np.ndarray) -> training_windows.TrainingWindows:
        return training_windows.training_windows_of(self.chain, self.force_records, unflat(water.tolist()))

    def _match(self, records, learnt) -> gauss_newton.Match:
        fleet = rollout.fish_batch_of(self.chain, self.robot, records)
        most = max(8, int(self.settings.swim / (fleet.mask.shape[1] * self.tick)))
        if len(fleet.q) > most:
            rng = np.random.default_rng([59, self.settings.seed])
            # drawn by block: otherwise the largest blocks would leave out the rare manoeuvres
            share = swims.shares([records[number].meta["block"] for number, _ in fleet.source])
            fleet = rollout.some(fleet, np.sort(rng.choice(len(fleet.q), most, replace=False, p=share)))
        tethered = [r for r in records if gauss_newton.flaps(r)]
        rows: RegressionRows | None = rows_of(self.chain, tethered) if tethered else None
        return gauss_newton.Match(self.swim, fleet, self.tick, rows, gauss_newton.tow_drag(self.chain, self.robot), learnt)

    def _report(self, stage: str, part: float, **figures) -> None:
        self.report(stage, self._share(stage, min(part, 1.0)), figures)

    def _share(self, stage: str, part: float) -> float:
        """Share of the whole fit that is done when `part` of a stage is."""
        took = TYPICAL | {"swims": TYPICAL["swims"] * self.settings.swims / 1000}
        before = sum(took[s] for s in STAGES[: STAGES.index(stage)])
        return (before + part * took[stage]) / sum(took.values())

    def _model(self, state) -> HydroModel:
        made, alone = (dict(zip(prediction_interval.CHANNELS, row, strict=True)) for row in state["bands"].tolist())
        slips = {float(r.meta["grid"].get("slip", 1.0)) for r in self.train}
        return HydroModel(
            name=self.robot.name,
            robot=self.robot.name,
            robot_sha256=robot_hash(self.robot),
            body_sha256=body_sha256(self.robot),
            dt=self.chain.dt,
            slip=slips.pop() if len(slips) == 1 else float("nan"),
            base=unflat(state["water"].tolist()),
            members=state["members"],
            alone=np.concatenate([state["alone"][None], state["alone_members"]]),
            learnt=learnt_of(state) if state["taken"] else None,
            found=self.found,
            dataset=self.dataset | {"train_s": sum(r.seconds for r in self.train), "val_s": sum(r.seconds for r in self.val)},
            band=made,
            band_alone=alone,
            scores=self._scores(state),
            notes="; ".join(self.notes),
        )

    def _scores(self, state) -> dict:
        """Scores of the model; `from_rest`: movement error of the strips (`rollout.from_rest`)."""
        whole = learnt_of(state) if state["taken"] else None
        rested = rollout.from_rest(self.swim, self.robot, [*self.train, *self.val], state["alone"])
        return {"validation": self.score(state["water"], whole), "from_rest": rested, "seconds": self.seconds}

    def _path(self, stage: str) -> Path | None:
        return None if self.folder is None else self.folder / f"stage-{STAGES.index(stage) + 1}-{stage}.safetensors"

    def _write(self, stage: str, state) -> None:
        path = self._path(stage)
        if path is not None:
            meta = {"key": self.key, "found": self.found, "notes": self.notes, "seconds": self.seconds}
            write_tensors(path, state, meta)

    def _read(self, stage: str) -> dict | None:
        """State after a stage that was finished for the same data and settings, or None."""
        path = self._path(stage)
        if path is None or not path.is_file():
            return None
        try:
            arrays, meta = read_tensors(path)
        except StoreError:  # cut short while it was written, or damaged: the stage is done again
            return None
        if meta["key"] != self.key:
            return None
        self.found, self.notes, self.seconds = meta["found"], meta["notes"], meta["seconds"]
        return arrays
