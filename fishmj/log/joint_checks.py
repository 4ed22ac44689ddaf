"""Physical checks of joints against their commands: rows of `physical_checks.CHECKS`; each yields (level, text) of a trial."""

from collections.abc import Iterator
from itertools import combinations

import numpy as np

from fishmj.log.course import (
    DRIVEN,
    FOLLOWS,
    GRID,
    IMPORT,
    NOTE,
    OTHER,
    PACE,
    USE,
    common_clock,
    correlation,
    delayed,
    mean_over,
)
from fishmj.log.trial import Trial
from fishmj.log.trial_check import Plausible
from fishmj.log.unread_rows import is_logged, is_sound, joints

WEAK = 0.3  # over `gain`: a weak servo still moves its joint by so much of a command that it follows
STRETCH, STRIDE = 2.0, 0.5  # s of a stretch in which a joint is looked at, and between two of them
FOLLOWED, SWAPPED = 0.9, 0.97  # correlation below which no command is followed; from which that of another joint is
LOYAL, NEARLY = 0.98, (0.67, 1.33)  # correlation from which a joint is noted, and times its command that it moves by
OPEN = 10.0  # bound that leaves the note out
TURNED = 1.0  # rad that a heading must turn through before links' angles against the tank are told


def standing_still(trial: Trial, bounds: Plausible) -> Iterator[tuple[str, str]]:
    """Findings on joints that do not move though their commands do, in all of the trial or from some time on."""
    for name, t, c, j in pairs(trial):
        told, moved = float(np.ptp(c)), float(np.ptp(j))
        if told > 2 * DRIVEN and t[-1] - t[0] > 1.0 and moved < bounds.still * told:
            text = (
                f"joint: {name} stands still ({np.degrees(moved):.2g} deg) while c{name[1:]} moves by {np.degrees(told):.3g} deg;"
                " is the servo unpowered or jammed, or is it another column?"
            )
            yield USE, text
        elif (stretches := _still_stretches(t, c, j, bounds)) and moved >= bounds.still * told:
            text = (
                f"joint: {name} stands still at t = {stretches[0]:.3g} s, {(len(stretches) - 1) * STRIDE + STRETCH:.3g} s in all,"
                f" while c{name[1:]} moves: did the servo lose its power, or jam?"
            )
            yield USE, text


def _still_stretches(t: np.ndarray, c: np.ndarray, j: np.ndarray, bounds: Plausible) -> list[float]:
    """Start times [s] of the stretches of `STRETCH` in which a command moves within the joint's reach and the joint does not."""
    rows, late = round(STRETCH / GRID), round(FOLLOWS[-1] / GRID)
    out = []
    for i in range(0, len(t) - rows, round(STRIDE / GRID)):
        told, moved = c[i : i + rows - late], float(np.ptp(j[i : i + rows]))
        within = np.clip(told, j.min(), j.max())
        if t[i + rows] - t[i] < 1.5 * STRETCH and np.ptp(within) > 4 * DRIVEN and moved < bounds.still * np.ptp(within):
            out.append(float(t[i]))
    return out


def joint_sign(trial: Trial, bounds: Plausible) -> Iterator[tuple[str, str]]:
    """Findings on joints that run against their commands at every plausible delay."""
    for name, t, c, j in pairs(trial):
        if np.ptp(c) < DRIVEN or np.ptp(j) < 0.2 * np.ptp(c) or t[-1] - t[0] < 1.0:
            continue
        found = [correlation(*delayed(c, j, lag)) for lag in FOLLOWS]
        worst, best = min(found), max(found)
        if worst < -bounds.against and best < OTHER:
            text = (
                f"joint: {name} runs against its command c{name[1:]} (correlation {worst:.2f}, at no delay up to"
                f" {FOLLOWS[-1]:.1f} s above {best:.2f}); one of the two counts the other way: give columns.{name} or"
                f" columns.c{name[1:]} a sign = -1 in the map"
            )
            yield IMPORT, text


def joint_scale(trial: Trial, bounds: Plausible) -> Iterator[tuple[str, str]]:
    """Findings on joints that follow their commands by a multiple, or a small part.

    Noted, too: all joints by less, as of commands that are shares, and one by more, as of an angle against the head. Of weak
    servos one or two, those under load, follow by so little.
    """
    followed: list[tuple[str, float, float]] = []
    for name, t, c, j in pairs(trial):
        if np.ptp(c) < 2 * DRIVEN or t[-1] - t[0] < 1.0:
            continue
        times, best = float(np.std(j) / np.std(c)), following(c, j)
        least = WEAK / bounds.gain
        if not least <= times <= bounds.gain and times > bounds.still and best > FOLLOWED:
            text = (
                f"joint: {name} moves by {times:.3g} times its command c{name[1:]} (correlation {best:.2f}; {least:.2g} to"
                f" {bounds.gain:g} times is plausible): another unit, or a gear between? Give columns.{name} a scale in the map"
            )
            yield USE, text
        else:
            followed.append((name, times, best))
    shared = [times for _, times, _ in followed]
    few = max(shared, default=1.0) < NEARLY[0]
    for name, times, best in followed if bounds.gain < OPEN else ():
        if best > LOYAL and (few or times > NEARLY[1]):
            why = "is the command a share of full deflection" if few else "is the angle one against the head, not the link before"
            yield NOTE, f"joint: {name} moves by {times:.3g} times its command c{name[1:]} (correlation {best:.2f}): {why}?"


def joint_order(trial: Trial, bounds: Plausible) -> Iterator[tuple[str, str]]:
    """Findings on two joints that follow each other's commands."""
    found = [pair for pair in pairs(trial) if np.ptp(pair[2]) > 2 * DRIVEN and len(pair[1]) > 50]
    if len({len(t) for _, t, _, _ in found}) != 1 or bounds.against >= 1.0:
        return
    own = np.array([[following(c, j) for _, _, _, j in found] for _, _, c, _ in found])
    for b, a in combinations(range(len(found)), 2):
        if min(own[a, b], own[b, a]) > SWAPPED and min(own[a, a], own[b, b]) < FOLLOWED:
            one, two = found[b][0], found[a][0]
            text = (
                f"joint: {one} follows c{two[1:]} and {two} follows c{one[1:]} (correlations {own[a, b]:.2f} and {own[b, a]:.2f};"
                f" their own {own[b, b]:.2f} and {own[a, a]:.2f}): are the two columns exchanged? Change them over in the map"
            )
            yield USE, text


def joint_frame(trial: Trial, bounds: Plausible) -> Iterator[tuple[str, str]]:
    """Findings on angles of links against the tank or the head, in place of angles between neighbours.

    Against the tank: every angle turns with the heading, theta_k = yaw + j_1 + .. + j_k. Against the head: theta_k follows the
    sum of the commands c_1 + .. + c_k, and not its own.
    """
    table, pose = trial.tables.get("joint", {}), trial.tables.get("pose", {})
    if bounds.against >= 1.0 or not is_sound(table, [*joints(table), "t"]):
        return
    if is_sound(pose, ["t", "yaw"]) and min(len(pose["t"]), len(table["t"])) > 20:
        grid = common_clock(table["t"], pose["t"])
        slow = lambda t, x: mean_over(np.interp(grid, t, np.unwrap(np.asarray(x, float))), round(PACE / GRID))
        if len(grid) > 5 / GRID and np.ptp(yaw := slow(pose["t"], pose["yaw"])) > TURNED:
            turning = [name for name in joints(table) if _turns(slow(table["t"], table[name]), yaw)]
            if turning and len(turning) == len(joints(table)):
                yield (
                    IMPORT,
                    f"joint: {', '.join(turning)} turn with the heading by {np.degrees(np.ptp(yaw)):.0f} deg: angles of links"
                    " against the tank? Expected: against the link before, the first one against the head. Write the differences",
                )
                return
    found = list(pairs(trial))
    if len({len(t) for _, t, _, _ in found}) == 1 and len(found) > 1 and [name for name, *_ in found] == joints(table):
        sums = np.cumsum([c for _, _, c, _ in found], axis=0)
        others = zip(found[1:], sums[1:], strict=True)
        if all(following(c, j) > SWAPPED and following(own, j) < FOLLOWED for (_, _, own, j), c in others):
            yield (
                IMPORT,
                f"joint: {', '.join(name for name, *_ in found[1:])} follow the sums of the commands up to theirs, not their own:"
                " angles of links against the head? Expected: against the link before. Write the differences",
            )


def following(c: np.ndarray, j: np.ndarray) -> float:
    """Largest correlation of a joint with a command at a plausible delay."""
    return max(correlation(*delayed(c, j, lag)) for lag in FOLLOWS)


def _turns(angle: np.ndarray, yaw: np.ndarray) -> bool:
    """Returns True if an angle turns with the heading, one for one."""
    slope = correlation(angle, yaw) * float(np.std(angle) / np.std(yaw))
    return correlation(angle, yaw) > SWAPPED and 0.8 < slope < 1.2


def pairs(trial: Trial) -> Iterator[tuple[str, np.ndarray, np.ndarray, np.ndarray]]:
    """(name, grid, command, joint), less their means, of each joint that has a command, while its torque is on."""
    cmd, joint = trial.tables.get("cmd", {}), trial.tables.get("joint", {})
    for name in joints(joint):
        number = name[1:]
        if f"c{number}" not in cmd or len(cmd["t"]) < 2 or len(joint["t"]) < 2:
            continue
        grid = common_clock(cmd["t"], joint["t"])
        if f"on{number}" in cmd and len(grid):
            held = np.searchsorted(cmd["t"], grid, side="right") - 1
            grid = grid[np.asarray(cmd[f"on{number}"])[held] > 0]
        grid = grid[is_logged(np.asarray(joint["t"], float), grid)]
        if len(grid) < 20:
            continue
        sent = np.searchsorted(cmd["t"], grid, side="right") - 1
        c = np.asarray(cmd[f"c{number}"], float)[sent]
        yield name, grid, c, np.interp(grid, joint["t"], np.asarray(joint[name], float))
