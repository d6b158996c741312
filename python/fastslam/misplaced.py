"""Landmarks that do not stand where their own sightings put them, along the path that came out.

What sees ranges or bearings alone, or is a sensor of one's own, leaves a landmark at several places until the
evidence leaves one. A filter may settle on a wrong one: then its sightings lie far off, or fit elsewhere as
well. Path and map of such a run belong together, as they are one solution of all sightings (`partial` in the
core); where they are a draw and a mean, residuals say nothing of single landmarks.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ._quantiles import chi_squared_quantile
from .errors import ModelError
from .laid import LOOK_S, believed
from .log import Floats, Ints
from .residuals import Group
from .result import RunResult
from .trust import FEW_ODD, MOST_WRONG, Doubt

ALARM = 1e-3
"""Probability by which a map in which all is right is accused, shared by all its landmarks."""
MOST_EXCESS = 2.0
"""Where the mean square of residuals is more than so many times the usual one, noise is the smaller part."""
TRIMMED = 0.1
"""The share of a landmark's sightings, those that fit worst, that is not looked at: names are misread."""
KEPT_SQUARE = 0.6228
"""Mean square of a standard normal variable without the tenth that is largest in size."""
TAIL = 4.0
"""Degrees of freedom of Student's t, by which places are compared: no single sighting decides."""
USUAL_LOSS = 1.0855
"""Mean of its loss for standard normal residuals, by numerical integration."""
COMPARED, GLANCED = 200, 50
"""Places are refined on so many sightings of a landmark, spread over all; the first choice takes fewer."""
ANCHORS, STARTS = 3, 8
"""So many sightings say where a landmark may be; of these places so many, apart, are refined."""
SPREAD = 0.15
"""Starts are apart where this share of the spread of all lies between them."""
APART = 4.0
"""Two places differ where they are further apart than this many of their standard deviations."""
ITERATIONS, STEP_M, SMALL_GAIN = 20, 1e-4, 1e-6
"""No step is taken that gains less, in nats."""
TOGETHER = 32
"""The places of so many landmarks are refined together."""
MOST_NAMED = 5


@dataclass(frozen=True)
class Place:
    """A place (2,) of a landmark, minus twice the logarithm of its likelihood there, and its covariance."""

    mean_m: Floats
    loss: float
    covariance_m2: Floats


_Places = tuple[Place, Place | None]


@dataclass(frozen=True)
class Stand:
    """What the sightings say of the landmark in a row of the map.

    `excess` is the mean square of its residuals without the worst, 1 where the noise explains them, and
    `looks` the moments of its sightings, those within a second counted once. `here` is the best place about
    that in the map and `other` the best one elsewhere, None where there is none.
    """

    row: int
    excess: float
    looks: int
    here: Place | None = None
    other: Place | None = None
    numbers: int = 0
    """So many numbers were compared at these places."""

    @property
    def gain(self) -> float:
        """By how many nats the other place fits better, in noise as large as it is there."""
        if self.here is None or self.other is None:
            return -np.inf
        noise = min(self.here.loss, self.other.loss) / (USUAL_LOSS * self.numbers)
        return 0.5 * (self.here.loss - self.other.loss) / max(noise, 1.0)


@dataclass(frozen=True)
class Misplaced:
    """Of a map the landmarks that stand elsewhere, and those that may: the strongest first.

    `ratio` has how many times its limit each of the first is beyond it.
    """

    elsewhere: tuple[Stand, ...] = ()
    ratio: tuple[float, ...] = ()
    undecided: tuple[Stand, ...] = ()
    landmarks: int = 0

    @property
    def rows(self) -> list[int]:
        """Rows of the map of all of them."""
        return [stand.row for stand in (*self.elsewhere, *self.undecided)]


def misplaced(result: RunResult, groups: tuple[Group, ...]) -> Misplaced:
    """The landmarks of which the map says that they are sure, and their sightings do not.

    Two limits, with a probability of `ALARM` shared among all. The mean square of residuals may be
    `MOST_EXCESS` times that of the others (and of the noise), and more by what chance adds to so many looks.
    Another place must be less likely by that probability; where it is more likely by as much the landmark
    stands elsewhere, in between it is undecided.
    """
    partial = result.config["sensor"]["model"] != "range_bearing" and not result.config.get("sensors")
    if result.interrupted or not partial or result.config["association"]["mode"] != "known":
        return Misplaced()
    stands = list(_stands(result, groups))
    if not stands:
        return Misplaced()
    share = ALARM / len(stands)
    least_nats = -float(np.log(share))
    excess = np.array([stand.excess for stand in stands])
    ratio = np.empty(len(stands))
    for k, stand in enumerate(stands):
        usual = max(1.0, float(np.median(np.delete(excess, k)))) if len(stands) > 1 else 1.0
        chance = chi_squared_quantile(1.0 - share, stand.looks) / stand.looks
        ratio[k] = max(stand.excess / (MOST_EXCESS * usual * chance), stand.gain / least_nats)
    order = [k for k in np.argsort(-ratio, kind="stable").tolist() if ratio[k] >= 1.0]
    unsure = [s for k, s in enumerate(stands) if ratio[k] < 1.0 and s.gain > -least_nats]
    return Misplaced(
        tuple(stands[k] for k in order),
        tuple(float(ratio[k]) for k in order),
        tuple(sorted(unsure, key=lambda stand: -stand.gain)),
        len(stands),
    )


def without_misplaced(result: RunResult, found: Misplaced) -> RunResult:
    """The result in which those are provisional, with a warning that names the undecided ones."""
    confirmed = result.landmarks.confirmed
    if not found.rows or confirmed is None:
        return result
    confirmed = confirmed.copy()
    confirmed[found.rows] = False
    warnings = result.warnings
    if found.undecided:
        warnings = (*warnings, _undecided(result, found.undecided))
    return replace(result, landmarks=replace(result.landmarks, confirmed=confirmed), warnings=warnings)


def doubts_of(result: RunResult, found: Misplaced) -> tuple[Doubt, ...]:
    """What speaks against the run: landmarks that stand elsewhere, by name, and very many that may."""
    return (*_elsewhere(result, found), *_too_many(found))


def _too_many(found: Misplaced) -> Iterator[Doubt]:
    count = len(found.undecided)
    if count:
        sentence = (
            f"{count:,} of {found.landmarks:,} landmarks may as well stand elsewhere by their sightings, as "
            "on the other side of the path: too many to believe the map"
        )
        yield Doubt("undecided", count / max(FEW_ODD, MOST_WRONG * found.landmarks), sentence)


def _elsewhere(result: RunResult, found: Misplaced) -> Iterator[Doubt]:
    if not found.elsewhere:
        return
    said = "; ".join(_said(result, stand) for stand in found.elsewhere[:MOST_NAMED])
    more = len(found.elsewhere) - MOST_NAMED
    sentence = (
        f"the places of {len(found.elsewhere):,} of {found.landmarks:,} landmarks are not to be believed, "
        f"and are provisional in the map: {said}" + (f"; and {more:,} more" if more > 0 else "")
    )
    yield Doubt("misplaced", max(found.ratio), sentence)


def _said(result: RunResult, stand: Stand) -> str:
    name, off = result.landmarks.ids[stand.row], np.sqrt(stand.excess)
    said = f"{name}: its sightings lie {off:.1f} standard deviations off where the noise says 1"
    if stand.gain <= 0.0:
        return said
    return f"{said}, and fit {_at(result, stand)} better by {stand.gain:,.0f} nats"


def _undecided(result: RunResult, stands: Sequence[Stand]) -> str:
    named = "; ".join(f"{result.landmarks.ids[s.row]} at {_at(result, s)}" for s in stands[:MOST_NAMED])
    more = f"; and {len(stands) - MOST_NAMED:,} more" if len(stands) > MOST_NAMED else ""
    return (
        f"{len(stands):,} of the landmarks may as well stand elsewhere by their sightings, and are "
        f"provisional in the map: {named}{more}; a path that bends, or passes them on another side, decides"
    )


def _at(result: RunResult, stand: Stand) -> str:
    assert stand.other is not None
    x_m, y_m = stand.other.mean_m
    far_m = float(np.hypot(*(stand.other.mean_m - result.landmarks.mean_m[stand.row])))
    return f"({x_m:.1f}, {y_m:.1f}), {far_m:.1f} m away"


@dataclass(frozen=True)
class _Sighted:
    """A landmark, where the map has it, and the sightings (n,) of it in a group."""

    mean_m: Floats
    covariance_m2: Floats
    rows: Ints


def _stands(result: RunResult, groups: tuple[Group, ...]) -> Iterator[Stand]:
    landmarks = result.landmarks
    for group in groups:
        order = np.argsort(group.landmark, kind="stable")
        ends = np.searchsorted(group.landmark[order], np.arange(len(landmarks.ids) + 1))
        sighted = [
            (row, _Sighted(landmarks.mean_m[row], landmarks.covariance_m2[row], rows))
            for row in np.flatnonzero(believed(result)).tolist()
            if len(rows := order[ends[row] : ends[row + 1]])
        ]
        for first in range(0, len(sighted), TOGETHER):
            some = sighted[first : first + TOGETHER]
            places = _places(group, [of for _, of in some])
            for (row, of), found in zip(some, places, strict=True):
                yield _stand(row, group, of, found)


def _stand(row: int, group: Group, of: _Sighted, places: _Places | None) -> Stand:
    square = np.sort(_off(group, of.rows, of.mean_m[None]).ravel() ** 2)
    kept = square[: int(np.ceil((1.0 - TRIMMED) * len(square)))]
    looks = len(np.unique(np.floor(group.stamp_s[of.rows] / LOOK_S)))
    stand = Stand(row, float(kept.mean() / KEPT_SQUARE), looks)
    return stand if places is None else replace(stand, here=places[0], other=places[1], numbers=len(square))


def _places(group: Group, sighted: Sequence[_Sighted]) -> list[_Places | None]:
    """Of each the best place about that in the map, and the best one elsewhere.

    None of those of which a sensor of one's own does not know what to expect where no filter has asked.
    """
    try:
        begins = [np.vstack([of.mean_m, _starts(group, of.rows)]) for of in sighted]
        few = [_some(of.rows, COMPARED) for of in sighted]
        rows = [rows for rows, begin in zip(few, begins, strict=True) for _ in begin]
        refined = _refined(group, rows, np.concatenate(begins))
        cuts = np.cumsum([len(begin) for begin in begins])[:-1]
        ends = zip(sighted, *(np.split(column, cuts) for column in refined), strict=True)
        return [_chosen(group, of, places, covariances) for of, places, covariances in ends]
    except ModelError:
        # One that it does not know must not cost the others.
        return [None] if len(sighted) == 1 else [found for of in sighted for found in _places(group, [of])]


def _starts(group: Group, rows: Ints) -> Floats:
    """Where a landmark may be by a few of its sightings (n, 2), the likeliest first and apart."""
    starts = np.concatenate([group.starts(row) for row in _some(rows, ANCHORS)])
    return _spread(starts[np.argsort(_loss(group, _some(rows, GLANCED), starts), kind="stable")])


def _chosen(group: Group, of: _Sighted, places: Floats, covariances: Floats) -> _Places:
    in_map = of.mean_m, of.covariance_m2
    places, covariances = np.vstack([in_map[0], places]), np.concatenate([in_map[1][None], covariances])
    loss = _loss(group, of.rows, places)
    far = np.array([_are_apart(in_map, other) for other in zip(places, covariances, strict=True)])
    near, away = (np.flatnonzero(rows_of) for rows_of in (~far, far))

    def best(of: Ints) -> Place:
        k = of[np.argmin(loss[of])]
        return Place(places[k], float(loss[k]), covariances[k])

    return best(near), best(away) if len(away) else None


def _some(rows: Ints, most: int) -> Ints:
    return rows if len(rows) <= most else rows[np.linspace(0, len(rows) - 1, most).astype(np.int64)]


def _spread(starts: Floats) -> Floats:
    """The first of the starts (n, 2) that are apart from each other."""
    apart_m = SPREAD * float(np.sqrt(starts.var(axis=0).sum()))
    kept = starts[:1]
    for start in starts[1:]:
        if len(kept) == STARTS:
            break
        if (np.hypot(*(kept - start).T) > apart_m).all():
            kept = np.vstack([kept, start])
    return kept


def _are_apart(one: tuple[Floats, Floats], other: tuple[Floats, Floats]) -> bool:
    between = other[0] - one[0]
    far_m = float(np.hypot(*between))
    if far_m == 0.0:
        return False
    along = between / far_m
    variance_m2 = np.array([along @ covariance @ along for _, covariance in (one, other)])
    return bool(far_m > APART * np.sqrt(np.maximum(variance_m2, 0.0)).sum())


def _off(group: Group, rows: Ints, places: Floats) -> Floats:
    """Normalised residuals (P, n, Z) of sightings (n,), were the landmark at each of the places (P, 2)."""
    off = group.off(np.tile(rows, len(places)), np.repeat(places, len(rows), axis=0))
    return off.reshape(len(places), len(rows), -1)


def _loss(group: Group, rows: Ints, places: Floats) -> Floats:
    """Minus twice the logarithm of the likelihood of each place (P,), up to a constant."""
    off = _off(group, rows, places)
    return np.asarray((TAIL + 1.0) * np.log1p(off**2 / TAIL).sum(axis=(1, 2)))


def _refined(group: Group, rows: Sequence[Ints], places: Floats) -> tuple[Floats, Floats]:
    """Gauss-Newton from each place (P, 2) by its own sightings, damped where it does not lead downhill.

    Returns places and covariances. One whose next step would gain next to nothing is left alone.
    """
    at, damping, left = places.copy(), np.full(len(places), 1e-3), np.arange(len(places))
    loss, information, gradient = _normal_equations(group, rows, at)
    for _ in range(ITERATIONS):
        damped = information[left] * (1.0 + damping[left, None, None] * np.eye(2))
        step = np.linalg.solve(damped, gradient[left, :, None])[..., 0]
        worth = (step * gradient[left]).sum(axis=1) > SMALL_GAIN
        left, step = left[worth], step[worth]
        if len(left) == 0:
            break
        moved = at[left] - step
        there = _normal_equations(group, [rows[place] for place in left.tolist()], moved)
        downhill = there[0] < loss[left]
        for now, new in zip((at, loss, information, gradient), (moved, *there), strict=True):
            now[left[downhill]] = new[downhill]
        damping[left] *= np.where(downhill, 0.1, 10.0)
    return at, np.asarray(np.linalg.inv(information))


def _normal_equations(group: Group, rows: Sequence[Ints], places: Floats) -> tuple[Floats, Floats, Floats]:
    """The loss (P,), its information (P, 2, 2) and gradient (P, 2), by differences.

    **Why all in one call:** a call for few sightings takes longer to make than to answer.
    """
    count, flat = np.array([len(of) for of in rows]), np.concatenate(rows)
    begin = np.cumsum(count) - count
    steps = [sign * step for step in STEP_M * np.eye(2) for sign in (1.0, -1.0)]
    around = np.concatenate([places, *(places + step for step in steps)])
    landmarks = np.repeat(around, np.tile(count, 1 + len(steps)), axis=0)
    off, *beside = group.off(np.tile(flat, 1 + len(steps)), landmarks).reshape(1 + len(steps), len(flat), -1)
    slopes = [(ahead - behind) / (2.0 * STEP_M) for ahead, behind in (beside[:2], beside[2:])]
    weighted = [slope * ((TAIL + 1.0) / (TAIL + off**2)) for slope in slopes]

    def summed(values: Floats) -> Floats:
        return np.asarray(np.add.reduceat(values.sum(axis=1), begin))

    information = np.array([[summed(one * other) for other in slopes] for one in weighted])
    least = 1e-9 * np.eye(2)  # in 1/m²: of what no sighting says anything
    gradient = np.column_stack([summed(slope * off) for slope in weighted])
    loss = (TAIL + 1.0) * summed(np.log1p(off**2 / TAIL))
    return loss, np.moveaxis(information, -1, 0) + least, gradient
