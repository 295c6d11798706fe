# SPDX-License-Identifier: Apache-2.0
"""The count, its interval, the verdict and the baselines."""

import pickle

import numpy as np
import pytest
from safetensors.numpy import save_file

from stack_counter.config import CounterConfig
from stack_counter.counting import conformal_quantile, make_count, verdict, with_reasons
from stack_counter.errors import ConfigError, PartError, WeightsError
from stack_counter.occupancy import make_estimator
from stack_counter.occupancy.baselines import FORMAT, Baselines, normalized_height
from stack_counter.types import (
    Container,
    HeightMap,
    OccupancyEstimate,
    Reason,
    StackVolume,
    ViewTally,
)


def volume(V, std=0.0, heights=None, floor=0.0, reasons=()):
    top = inner = None
    if heights is not None:
        top = HeightMap(np.eye(4), 0.01, np.asarray(heights, np.float32))
        inner = HeightMap(np.eye(4), 0.01, np.full_like(top.heights, floor))
    return StackVolume(0, V, std, Container("none", np.eye(4)), (0, 0, 0), 1.0, top, inner, None,
                       ViewTally(), reasons)


def estimate(gamma=1.0, std=0.0, scores=(0.0,)):
    return OccupancyEstimate(gamma, std, np.array(scores), "test")


@pytest.mark.parametrize("k", [1, 37, 412])
def test_gamma_1_and_k_unit_volumes_count_k(k):
    count = make_count(volume(k * 2e-6), 2e-6, estimate(), 0.9)
    assert (count.count, count.count_interval) == (k, (k, k))


def test_interval_is_that_of_the_scores_of_99():
    """Of 99 scores the 5th and the 95th bound 90%."""
    count = make_count(volume(1e-3), 1e-6, estimate(0.4, 0.04, np.linspace(-4.9, 4.9, 99)), 0.9)
    assert count.count == 400
    low, high = (400 * np.exp(0.1 * x) for x in (-4.5, 4.5))
    assert count.count_interval == (int(low), int(high) + 1)


@pytest.mark.parametrize("share, score", [(0.05, 0), (0.25, 1), (0.75, 8), (0.95, 9)])
def test_few_scores_give_wide_quantiles(share, score):
    """Ten scores: k of share * 11, away from the middle, and never beyond the ends."""
    scores = np.random.default_rng(0).permutation(np.arange(10.0))
    assert conformal_quantile(scores, share) == score


def test_interval_widens_with_the_error_of_v_and_with_confidence():
    def width(std, confidence):
        of = estimate(0.4, 0.02, np.linspace(-2, 2, 101))
        low, high = make_count(volume(1e-3, std), 1e-6, of, confidence).count_interval
        assert low <= 400 <= high
        return high - low

    assert width(0, 0.5) < width(0, 0.9) < width(1e-4, 0.9) < width(2e-4, 0.9)


def test_empty_counts_zero():
    count = make_count(volume(0.0), 1e-6, estimate(0.4), 0.9)
    assert (count.count, count.count_interval, count.status) == (0, (0, 0), "ok")


@pytest.mark.parametrize("unit_volume", [0.0, -1e-6, float("nan"), float("inf")])
def test_unit_volume_must_be_positive(unit_volume):
    with pytest.raises(PartError, match="expected a finite number above 0"):
        make_count(volume(1e-3), unit_volume, estimate(), 0.9)


def test_reasons_degrade():
    assert make_count(volume(1e-3, reasons=(Reason.NO_DEPTH,)), 1e-6, estimate(), 0.9).status \
        == "degraded"
    plain = make_count(volume(1e-3), 1e-6, estimate(), 0.9)
    assert plain.status == "ok"
    assert with_reasons(plain, *2 * [Reason.BAG_TRUNCATED]).reasons == (Reason.BAG_TRUNCATED,)


@pytest.mark.parametrize("interval, said", [((95, 105), "pass"), ((90, 110), "pass"),
                                            ((89, 105), "unsure"), ((111, 130), "fail"),
                                            ((10, 89), "fail"), ((100, 111), "unsure")])
def test_verdict(interval, said):
    assert verdict(interval, 100, 10) == said
    assert verdict(interval, 0, 10) == "none"


def test_normalized_height_of_flat_and_half_empty_maps():
    flat = np.full((20, 20), 0.05)
    assert normalized_height(volume(1e-3, heights=flat, floor=0.01)) == pytest.approx(1)
    flat[:10] = 0.01
    assert normalized_height(volume(1e-3, heights=flat, floor=0.01)) == pytest.approx(0.5)
    assert normalized_height(volume(1e-3)) is None


def weights(path, kind=FORMAT, **changes):
    tensors = {"line": np.array([0.5, 0.1]), "prior": np.array([0.5, 0.1]),
               **{f"ratios_{n}": np.linspace(0.5, 1.5, 11)
                  for n in ("corrected", "extrapolated", "prior")}, **changes}
    save_file({k: v for k, v in tensors.items() if v is not None}, path,
              metadata={"format": kind})
    return path


def test_estimators_read_the_map_and_name_themselves_baselines(tmp_path):
    path = weights(tmp_path / "w.safetensors")
    flat = volume(1e-3, heights=np.full((20, 20), 0.05))
    for name, gamma in (("depth_corrected", 0.6), ("depth_extrapolated", 1.0), ("prior", 0.5)):
        got = make_estimator(CounterConfig(estimator=name, weights=str(path))).estimate(flat, 1e-6)
        assert got.gamma == pytest.approx(gamma) and got.estimator == f"{name} (baseline)"
    corrected = make_estimator(CounterConfig(estimator="depth_corrected", weights=str(path)))
    blind = corrected.estimate(volume(1e-3), 1e-6)
    assert (blind.gamma, blind.reasons) == (0.5, ("no_depth",))
    with pytest.raises(ConfigError, match="unknown estimator"):
        make_estimator(CounterConfig(estimator="guess", weights=str(path)))


def test_shipped_weights_load():
    fit = Baselines()
    assert 0.2 < fit.prior[0] < 0.8 and len(fit.ratios["corrected"]) > 50


def test_bad_weights_are_refused(tmp_path):
    good = weights(tmp_path / "good.safetensors")
    cases = {"missing": tmp_path / "none.safetensors", "cut": tmp_path / "cut.safetensors",
             "pickle": tmp_path / "w.pkl",
             "other": weights(tmp_path / "other.safetensors", "something else"),
             "lacking": weights(tmp_path / "lacking.safetensors", prior=None),
             "nan": weights(tmp_path / "nan.safetensors", line=np.array([np.nan, 0]))}
    cases["cut"].write_bytes(good.read_bytes()[:-40])
    cases["pickle"].write_bytes(pickle.dumps({"line": 1}))
    for name, path in cases.items():
        with pytest.raises(WeightsError, match=path.name):
            Baselines(path)
            pytest.fail(name)


@pytest.mark.parametrize("v, V", [(1e-30, 1e-3), (5e-324, 1e-3), (1e-6, 1e300)])
def test_a_count_that_no_container_holds_is_refused(v, V):
    with pytest.raises(PartError, match="expected at most 1e[+]09: check the part's volume"):
        make_count(volume(V), v, estimate(), 0.9)


def test_an_interval_without_end_is_as_wide_as_messages_go():
    count = make_count(volume(1e-3, std=1e3), 1e-6, estimate(scores=(-1.0, 1.0)), 0.9)
    assert count.count_interval == (0, 2**32 - 1)
