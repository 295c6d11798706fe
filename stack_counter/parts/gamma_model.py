"""What is known of one part's gamma, as one Gaussian over its scans.

For each scan of a part stand two numbers: t, the log of its true gamma (over the measured V), and
y, the log of what the estimator says. Both are linear in what the fill looks like in parts, and
share with all other scans of that part on that rig an offset that nobody has seen (friction; how
the part nests; how the network misreads it):

    (t, y) = (B + U) x + e,    x = (1, 1 / (h + 1/2), 1 / w),

h and w being fill height and container width in part lengths, U the same for all scans with
covariance `shared`, e new in each with covariance `noise`. What is asked for, t of a scan given
its y and counted scans (t, y), is then one conditional expectation: the network, the part's
simulated piles and the counted scans are joined by their variances.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from stack_counter.errors import PartError, ScanError
from stack_counter.files import write_atomically
from stack_counter.types import StackVolume

FEATURES = 3
FORMAT = "stack_counter part model 1"
_SOFT = 0.5  # l, added to the height: a single layer is no singularity
_LEAST_SHARE = 0.1  # of the variance that gamma keeps when V's own is taken out


@dataclass(frozen=True)
class Reading:
    """One scan of a part.

    Attributes:
        height, width: mean height over the footprint, and the root of its area, in l = v**(1/3).
        said: log of the estimator's gamma; NaN if there is none to compare.
        true: log of count * v / V; NaN if the scan is not counted.
    """

    height: float
    width: float
    log_gamma_estimated: float = np.nan
    log_gamma_counted: float = np.nan


@dataclass(frozen=True)
class GammaPosterior:
    """What is thought of a scan's log gamma: mean, standard deviation (V's own error taken out),
    shares of what it comes from (they sum to 1), and by how many standard deviations the
    estimator is off what was expected of it."""

    mean: float
    std: float
    shares: dict[str, float]
    surprise: float


@dataclass(frozen=True)
class GammaModel:
    """The Gaussian of the module's docstring.

    Attributes:
        coefficients: (2, FEATURES) float64 B; rows t, y.
        shared: (2 * FEATURES, 2 * FEATURES) covariance of U, t's coefficients first.
        noise: (2, 2) covariance of e.
        volume_variance: mean variance of log V that `noise` contains.
        scores: (n,) errors of t on piles left out, in their standard deviations.
        least: (2,) smallest height and width that it was fitted on, l.
        friction: (2,) change of t and y per 1 of friction; NaN where not known.
        source: what it knows the part from, as `shares` calls it: `piles` of this part, or
            `training` piles of others.
    """

    coefficients: np.ndarray
    shared: np.ndarray
    noise: np.ndarray
    volume_variance: float
    scores: np.ndarray
    least: np.ndarray
    friction: np.ndarray
    source: str

    def believe(self, scan: Reading, counted: Sequence[Reading] = (), unit_std: float = 0.0
                ) -> GammaPosterior:
        """t of a scan.

        Args:
            scan: not counted.
            counted: other scans of the part on the same rig.
            unit_std: relative standard deviation of v, an error that all scans share.
        """
        scans = [*counted, scan]
        mean, covariance = self._joint(scans, unit_std)
        n, values = (
            len(scans),
            np.array([[s.log_gamma_counted, s.log_gamma_estimated] for s in scans]).T.ravel(),
        )
        new, said = n - 1, 2 * n - 1
        known = np.flatnonzero(np.isfinite(values))
        history = known[known != said]
        before, spread = condition_gaussian(
            mean, covariance, values, history
        )  # counted scans alone
        weight, surprise = 0.0, 0.0
        if np.isfinite(scan.log_gamma_estimated):
            difference = scan.log_gamma_estimated - before[said]
            weight = float(np.clip(spread[new, said] / spread[said, said], 0, 1))
            surprise = float(difference) / np.sqrt(spread[said, said])
        after, narrow = condition_gaussian(mean, covariance, values, known)
        std = np.sqrt(max(narrow[new, new] - self.volume_variance,
                          _LEAST_SHARE * narrow[new, new]))
        learnt = 1 - (spread[new, new] - self.noise[0, 0]) / (
            covariance[new, new] - self.noise[0, 0]) if len(history) else 0.0
        learnt = float(np.clip(learnt, 0, 1))
        shares = {"estimator": weight, self.source: (1 - weight) * (1 - learnt)}
        if len(history):
            shares["counted"] = (1 - weight) * learnt
        return GammaPosterior(float(after[new]), float(std), shares, float(surprise))

    def expected_count_error(self, scan: Reading, counted: Sequence[Reading], unit_std: float = 0.0
                             ) -> float:
        """By how many standard deviations a counted scan disagrees with those before it."""
        mean, covariance = self._joint([*counted, scan], unit_std)
        values = np.array(
            [[s.log_gamma_counted, s.log_gamma_estimated] for s in [*counted, scan]]
        ).T.ravel()
        new, known = len(counted), np.flatnonzero(np.isfinite(values))
        after, narrow = condition_gaussian(mean, covariance, values, known[known != new])
        return float((scan.log_gamma_counted - after[new]) / np.sqrt(narrow[new, new]))

    def gamma_at(self, height: float, width: float) -> tuple[float, float]:
        """gamma of a fill before anything was seen of it, and its standard deviation."""
        mean, covariance = self._joint([Reading(height, width)], 0.0)
        gamma = float(np.exp(mean[0]))
        return gamma, gamma * float(np.sqrt(covariance[0, 0]))

    def covers(self, scan: Reading) -> bool:
        """Whether such fills were among those it was fitted on; large ones differ little."""
        return bool(scan.height >= self.least[0] and scan.width >= self.least[1])

    def _joint(self, scans: Sequence[Reading], unit_std: float) -> tuple[np.ndarray, np.ndarray]:
        """Mean (2 n,) and covariance of all t, then all y."""
        x = features(np.array([s.height for s in scans]), np.array([s.width for s in scans]))
        both = np.kron(np.eye(2), x)  # (2 n, 2 FEATURES)
        shared = self.shared.copy()
        shared[0, 0] += unit_std**2
        covariance = both @ shared @ both.T + np.kron(self.noise, np.eye(len(scans)))
        return both @ self.coefficients.ravel(), covariance

    @cached_property
    def per_tenth_of_friction(self) -> float:
        """Relative change of gamma per 0.1 of friction."""
        return float(np.exp(0.1 * self.friction[0]) - 1)

    def per_tenth_of_width(self, height: float, width: float) -> float:
        """Relative change of gamma where the container is taken 10% too wide."""
        wrong, right = self.gamma_at(height, 1.1 * width)[0], self.gamma_at(height, width)[0]
        return wrong / right - 1


@dataclass(frozen=True)
class PartModels:
    """A part's Gaussians.

    Attributes:
        estimator: name of who said `Reading.log_gamma_estimated`.
        arc: of scans from around.
        one_side: of single views from above.
        made: how, for people.
    """

    estimator: str
    arc: GammaModel
    one_side: GammaModel
    made: str

    def write(self, path: Path) -> None:
        """Writes them as JSON. Raises OSError."""
        document = {"format": FORMAT, "estimator": self.estimator, "made": self.made,
                    **{name: _as_lists(getattr(self, name)) for name in _VIEWED}}
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, json.dumps(document) + "\n")


_VIEWED = ("arc", "one_side")
_SHAPES = {"coefficients": (2, FEATURES), "shared": (2 * FEATURES,) * 2, "noise": (2, 2),
           "least": (2,), "friction": (2,)}


def read_models(path: Path) -> PartModels:
    """What `PartModels.write` wrote.

    Raises:
        PartError: missing, or not such a file.
    """
    try:
        document = json.loads(path.read_text())
        if document["format"] != FORMAT:
            raise ValueError(f"format '{document['format']}' (not '{FORMAT}')")
        arc, one_side = (_model(document[name]) for name in _VIEWED)
        return PartModels(str(document["estimator"]), arc, one_side, str(document["made"]))
    except OSError as error:
        raise PartError(f"no gamma prior {path}: {error.strerror}; expected the file that "
                        "`stack-counter part add` writes") from error
    except (KeyError, TypeError, ValueError) as error:
        raise PartError(f"{path} is no gamma prior: {error}; expected the file that "
                        "`stack-counter part add` writes") from error


def _model(values: dict) -> GammaModel:
    arrays = {key: np.array(values[key], float) for key in (*_SHAPES, "scores")}
    for key, shape in _SHAPES.items():
        if arrays[key].shape != shape:
            raise ValueError(f"{key} of shape {arrays[key].shape} (not {shape})")
    if not arrays["scores"].size:
        raise ValueError("no scores")
    return GammaModel(volume_variance=float(values["volume_variance"]),
                      source=str(values["source"]), **arrays)


def _as_lists(model: GammaModel) -> dict:
    return {key: np.array([float(f"{x:.6g}") for x in value.ravel()]).reshape(value.shape).tolist()
            if isinstance(value, np.ndarray) else value for key, value in asdict(model).items()}


def features(height: np.ndarray, width: np.ndarray) -> np.ndarray:
    """(n, FEATURES) of (n,) heights and widths in l."""
    return np.stack([np.ones_like(height), 1 / (height + _SOFT), 1 / width], axis=1)


def size_of(volume: StackVolume, unit_volume: float) -> tuple[float, float]:
    """Mean height of a stack over its footprint and the root of that one's area, in l.

    Raises:
        ScanError: the scan has no depth, or shows no footprint.
    """
    if volume.top is None or volume.inner is None:
        raise ScanError("no top-surface map; expected one: the scan has no depth")
    cells = np.isfinite(volume.top.heights) & np.isfinite(volume.inner.heights)
    area = np.count_nonzero(cells) * volume.top.pitch**2
    if not area:
        raise ScanError(f"0 of {cells.size} cells of the top surface are finite; expected some")
    length = unit_volume ** (1 / 3)
    return volume.stack_volume / area / length, float(np.sqrt(area)) / length


def condition_gaussian(
    mean: np.ndarray, covariance: np.ndarray, values: np.ndarray, known: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance of a Gaussian, some of whose values are known."""
    if not len(known):
        return mean, covariance
    gain = np.linalg.solve(covariance[np.ix_(known, known)], covariance[known]).T
    return (mean + gain @ (values[known] - mean[known]),
            covariance - gain @ covariance[known])
