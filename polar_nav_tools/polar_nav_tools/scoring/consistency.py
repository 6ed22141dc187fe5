"""Consistency of covariances: normalized squared errors against their chi-square bands.

NEES is e' P^-1 e of an estimate against truth, NIS is r' S^-1 r of an innovation; of an honest
filter each is chi-square distributed with as many degrees of freedom as it has components.
Innovations of an honest filter are white, so the mean of N of them has the band of chi2(N dof)/N.
Errors along one run are not: 6000 states at 10 Hz are perhaps 50 independent ones, and a leader's
constant offset is one for as long as it lasts. The band of a mean NEES therefore uses an effective
number of samples, from the autocorrelation of the whitened errors about zero, their mean when
honest (about the mean of the run a constant error would look like noise around it). It is
indicative, and a Monte-Carlo run over seeds is the real test.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import gammaincinv

from .json_values import record

Floats = NDArray[np.float64]

PROBABILITY = 0.95  # of the bands shown

CONSISTENT = 'consistent'
OPTIMISTIC = 'optimistic'
PESSIMISTIC = 'pessimistic'
UNKNOWN = 'unknown'


@dataclass(frozen=True)
class Consistency:
    """Normalized squared errors of one kind over one window."""

    count: int
    missing: int  # without a finite, positive definite covariance
    dof: float  # mean degrees of freedom
    mean: float
    mean_per_dof: float  # 1 for an honest covariance
    effective_count: float  # independent samples; equal to `count` for innovations
    band_low: float  # of `mean_per_dof`, two-sided, PROBABILITY
    band_high: float
    share_inside: (
        float  # of samples (or sums) in their own band; PROBABILITY for an honest covariance
    )

    @property
    def judgement(self) -> str:
        """Judgement in a word: optimistic if errors are larger than the covariance states."""
        if self.count == 0 or not np.isfinite(self.band_low):
            return UNKNOWN
        if self.mean_per_dof > self.band_high:
            return OPTIMISTIC
        return PESSIMISTIC if self.mean_per_dof < self.band_low else CONSISTENT

    def to_dict(self) -> dict[str, object]:
        """Plain numbers for JSON; None where there is no number."""
        return record({**asdict(self), 'judgement': self.judgement})


def chi_square_band(dof: ArrayLike, probability: float = PROBABILITY) -> tuple[Floats, Floats]:
    """Two-sided band of a chi-square variable with equal tails.

    Parameters
    ----------
    dof : array_like
        Degrees of freedom, > 0; need not be whole.
    probability : float
        Inside the band, in (0, 1).

    Returns
    -------
    low, high : ndarray
        Quantiles: chi2.ppf(p, k) = 2 P^-1(k / 2, p) with the regularized incomplete gamma function
        P.
    """
    if not 0.0 < probability < 1.0:
        raise ValueError(f'probability={probability} must be in (0, 1)')
    half = np.asarray(dof, dtype=np.float64) / 2.0
    tail = (1.0 - probability) / 2.0
    each = np.unique(half)  # few among hundreds of thousands
    at = np.searchsorted(each, half)
    low, high = 2.0 * gammaincinv(each, tail), 2.0 * gammaincinv(each, 1.0 - tail)
    return low[at], high[at]


@np.errstate(over='ignore', invalid='ignore')  # a damaged message can hold any number
def whitened(error: ArrayLike, covariance: ArrayLike) -> Floats:
    """Errors divided by the root of their covariance, L^-1 e: of an honest filter N(0, I).

    Parameters
    ----------
    error : array_like, shape (n, k)
    covariance : array_like, shape (n, k, k)
        Symmetric, P = L L'; in the square of the unit of `error`.

    Returns
    -------
    ndarray, shape (n, k)
        NaN where anything is not finite or the covariance is not positive definite.
    """
    e = np.asarray(error, dtype=np.float64)
    P = np.asarray(covariance, dtype=np.float64)
    if e.ndim != 2 or P.shape != (*e.shape, e.shape[1]):
        raise ValueError(
            f'error has shape {e.shape}, covariance {P.shape}; want (n, k) and (n, k, k)'
        )
    out = np.full(e.shape, np.nan)
    variance = np.diagonal(P, axis1=1, axis2=2)
    usable = np.isfinite(e).all(1) & np.isfinite(P).all((1, 2)) & (variance > 0.0).all(1)
    rows = np.flatnonzero(usable)
    if rows.size == 0:
        return out
    # In units of sigma first: mixed magnitudes then do not spoil the test for definiteness.
    sigma = np.sqrt(variance[rows])
    correlation = P[rows] / (sigma[:, :, None] * sigma[:, None, :])
    z = e[rows] / sigma
    definite = _definite(correlation)
    rows, correlation, z = rows[definite], correlation[definite], z[definite]
    out[rows] = np.linalg.solve(np.linalg.cholesky(correlation), z[:, :, None])[:, :, 0]
    return out


@np.errstate(over='ignore')
def normalized_squared(error: ArrayLike, covariance: ArrayLike) -> Floats:
    """Squared errors in units of their covariance, e' P^-1 e, shape (n,); NaN as `whitened`."""
    squared: Floats = np.square(whitened(error, covariance)).sum(1)
    return squared


def _definite(correlation: Floats, least: float = 1e-12) -> NDArray[np.bool_]:
    """Mask (n,) of matrices (n, k, k) with all eigenvalues above `least`."""
    try:
        # Usually all of them, and a factorization says so in a sixth of the time of eigenvalues.
        np.linalg.cholesky(correlation - least * np.eye(correlation.shape[-1]))
    except np.linalg.LinAlgError:
        # Of damaged ones eigenvalues may not even converge.
        definite = np.asarray((np.abs(correlation) <= 1.0 + 1e-9).all(axis=(1, 2)))
        definite[definite] = np.linalg.eigvalsh(correlation[definite])[:, 0] > least
        return definite
    return np.ones(len(correlation), np.bool_)


def effective_count(whitened_errors: ArrayLike) -> float:
    """Number of independent samples with the same variance of the mean square as a series.

    The squares of Gaussian numbers of mean zero with autocorrelation rho have the autocorrelation
    rho^2, so the mean of n of them has the variance of n / tau independent ones, with
    tau = sum of rho^2 over all lags, summed while rho stays positive; the mean tau of the
    components. At least 1, at most n.

    Parameters
    ----------
    whitened_errors : array_like, shape (n, k)
        In order of time; rows with a value that is not finite are left out.
    """
    w = np.asarray(whitened_errors, dtype=np.float64)
    w = w[np.isfinite(w).all(1)]
    n = len(w)
    if n < 4:
        return float(n)
    return max(1.0, n / float(np.mean([_correlation_length(x) for x in w.T])))


def _correlation_length(x: Floats) -> float:
    """Tau of one component: 1 if it is white, n if it is constant."""
    n, largest = x.size, float(np.max(np.abs(x)))
    if largest == 0.0:
        return float(n)
    x = x / largest  # its square is finite, whatever a damaged message holds
    size = 1 << (2 * n - 1).bit_length()
    spectrum = np.fft.rfft(x, size)
    # Sum over n - lag products by their number: of a constant x rho is 1 at every lag.
    rho = np.fft.irfft(spectrum * spectrum.conj(), size)[:n] / np.arange(n, 0, -1)
    rho = np.clip(rho / rho[0], -1.0, 1.0)
    pairs = rho[: n - n % 2].reshape(-1, 2).sum(1)
    negative = np.flatnonzero(pairs <= 0.0)
    stop = 2 * int(negative[0]) if negative.size else n
    return float(min(n, max(1.0, 2.0 * np.square(rho[:stop]).sum() - 1.0)))


def consistency(squared: ArrayLike, dof: ArrayLike) -> Consistency:
    """Consistency of the normalized squares of innovations with their chi-square band.

    Parameters
    ----------
    squared : array_like, shape (n,)
        NIS; values that are not finite are left out and counted. Independent of one another.
    dof : array_like, scalar or shape (n,)
        Degrees of freedom of each.
    """
    return _consistency(squared, dof, None)


def consistency_along(whitened_errors: ArrayLike) -> Consistency:
    """Consistency of errors along a run, which are not independent, with their chi-square band.

    Parameters
    ----------
    whitened_errors : array_like, shape (n, k)
        From `whitened`, in order of time; rows that are not finite are left out and counted.
    """
    w = np.asarray(whitened_errors, dtype=np.float64)
    with np.errstate(over='ignore'):
        squared = np.square(w).sum(1)
    return _consistency(squared, w.shape[1], effective_count(w))


def _consistency(squared: ArrayLike, dof: ArrayLike, independent: float | None) -> Consistency:
    """Consistency of normalized squares of which so many are independent; None: all."""
    all_values = np.asarray(squared, dtype=np.float64)
    all_dof = np.broadcast_to(np.asarray(dof, dtype=np.float64), all_values.shape)
    good = np.isfinite(all_values) & (all_dof > 0.0)
    values, k = all_values[good], all_dof[good]
    missing = int(all_values.size - values.size)
    if values.size == 0:
        nan = float('nan')
        return Consistency(0, missing, nan, nan, nan, 0.0, nan, nan, nan)
    n_eff = float(values.size) if independent is None else max(1.0, independent)
    dof_total = n_eff * float(k.mean())
    low, high = chi_square_band(dof_total)
    each_low, each_high = chi_square_band(k)
    return Consistency(
        count=int(values.size),
        missing=missing,
        dof=float(k.mean()),
        mean=float(values.mean()),
        mean_per_dof=float(values.sum() / k.sum()),
        effective_count=n_eff,
        band_low=float(low) / dof_total,
        band_high=float(high) / dof_total,
        share_inside=float(np.mean((values >= each_low) & (values <= each_high))),
    )


def consistency_of_sums(sums: ArrayLike, counts: ArrayLike, dof: int) -> Consistency:
    """Consistency of innovations known as sums over short intervals.

    The sum of n normalized squares of an honest filter is chi2(n dof), so sums serve as well as
    single values; `share_inside` is of intervals in the band of their own n.

    Parameters
    ----------
    sums, counts : array_like, shape (n,)
        Sum of the NIS, and how many stand in it, per interval.
    dof : int
        Degrees of freedom of one measurement.
    """
    total, number = np.asarray(sums, dtype=np.float64), np.asarray(counts, dtype=np.float64)
    used = number > 0.0
    total, number = total[used], number[used]
    good = np.isfinite(total)
    missing = int(number[~good].sum())
    total, number = total[good], number[good]
    if total.size == 0:
        nan = float('nan')
        return Consistency(0, missing, nan, nan, nan, 0.0, nan, nan, nan)
    n = float(number.sum())
    low, high = chi_square_band(n * dof)
    each_low, each_high = chi_square_band(number * dof)
    return Consistency(
        count=int(n),
        missing=missing,
        dof=float(dof),
        mean=float(total.sum()) / n,
        mean_per_dof=float(total.sum()) / (n * dof),
        effective_count=n,
        band_low=float(low) / (n * dof),
        band_high=float(high) / (n * dof),
        share_inside=float(np.mean((total >= each_low) & (total <= each_high))),
    )
