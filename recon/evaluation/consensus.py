"""Random sample consensus: which of many guesses most points agree with.

RANSAC counts the points within a threshold (Fischler and Bolles 1981). MLESAC weighs each point by the likelihood of a
mixture of Gaussian inliers and uniform outliers (Torr and Zisserman 2000).
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float64

# Guesses are judged on so many points at most; the winner is refined on all of them. The share of inliers is then
# known to 1 %.
JUDGES = 4000
BATCH = 64
# A threshold is where 95 % of Gaussian errors lie below.
SD_PER_THRESHOLD = 1 / 1.96
CONFIDENCE = 0.999

Residuals = Float64[np.ndarray, "guesses points"]
Scores = Float64[np.ndarray, " guesses"]
Guesses = Float64[np.ndarray, "guesses parameters"]


def ransac_score(residual_mm: Residuals, *, threshold_mm: float) -> Scores:
    """Return for each guess the share of points within the threshold."""
    return (np.abs(residual_mm) <= threshold_mm).mean(axis=1)


def mlesac_score(residual_mm: Residuals, *, threshold_mm: float, span_mm: float, rounds: int = 5) -> Scores:
    """Return for each guess the mean log likelihood of its residuals.

    Inliers are Gaussian with 95 % of them below ``threshold_mm``; outliers are uniform over ``span_mm``. The share of inliers
    is found for each guess by expectation maximisation.
    """
    sd_mm = threshold_mm * SD_PER_THRESHOLD
    inlier = np.exp(-0.5 * (residual_mm / sd_mm) ** 2) / (np.sqrt(2 * np.pi) * sd_mm)
    outlier = 1 / max(span_mm, threshold_mm)
    share = np.full((len(residual_mm), 1), 0.5)
    for _ in range(rounds):
        mixture = share * inlier + (1 - share) * outlier
        share = (share * inlier / mixture).mean(axis=1, keepdims=True)
    return np.log(share * inlier + (1 - share) * outlier).mean(axis=1)


def best_guess(
    guess: Callable[[int], Guesses],
    residual_mm: Callable[[Guesses], Residuals],
    score: Callable[[Residuals], Scores],
    *,
    sample_size: int,
    threshold_mm: float,
    most_guesses: int,
) -> Float64[np.ndarray, " parameters"]:
    """Draw guesses until a sample free of outliers is nearly certain, and return the best.

    Parameters
    ----------
    guess
        Draws so many guesses; a degenerate one is a row of NaN.
    residual_mm
        Distances of the judging points to each guess.
    score
        Larger is better.
    sample_size
        Points a guess is made of, for the number of guesses needed: log(1 − p) / log(1 − wᵐ).
    """
    best, best_score, drawn, needed = None, -np.inf, 0, float(most_guesses)
    while drawn < min(needed, most_guesses):
        guesses = guess(BATCH)
        drawn += BATCH
        guesses = guesses[np.isfinite(guesses).all(axis=1)]
        if not len(guesses):
            continue
        residuals = residual_mm(guesses)
        scores = score(residuals)
        winner = int(scores.argmax())
        if scores[winner] > best_score:
            best, best_score = guesses[winner], float(scores[winner])
            clean = float(ransac_score(residuals[[winner]], threshold_mm=threshold_mm)[0]) ** sample_size
            needed = np.log(1 - CONFIDENCE) / np.log1p(-min(clean, 1 - 1e-12)) if clean > 0 else np.inf
    if best is None:
        raise ValueError(f"none of {drawn} samples of {sample_size} points gave a shape")
    return best


def judges(
    points: Float64[np.ndarray, "points columns"], rng: np.random.Generator
) -> Float64[np.ndarray, "some columns"]:
    """Return a random part of the points, enough to compare guesses."""
    if len(points) <= JUDGES:
        return points
    return points[rng.choice(len(points), JUDGES, replace=False)]


def draw(count: int, sample_size: int, points: int, rng: np.random.Generator) -> np.ndarray:
    """Return row numbers [count, sample_size]; a row that repeats a point makes a degenerate guess, no harm."""
    return rng.integers(0, points, (count, sample_size))
