"""KSTA: kernel shape trajectories, coefficients that are a smooth function of what the frames look like.

minimise over X   ½‖(I − MM⁺)W‖²_F,   M = R(ΩX ⊗ I₃),   S = (ΩX ⊗ I₃) M⁺W

as ``csf1``, with Ω (F×d) the leading eigenvectors of a kernel matrix over frames in place of cosines, so that similar
frames get similar coefficients, whenever they occur: the order of the frames does not matter. The kernel is
κ_fg = exp(−E_fg/2σ²), and E_fg is

- ``rik``, rotation-invariant kernel: ‖z_f − e^{iθ}z_g‖² at the best θ, which is 2 − 2|z_fᴴz_g|, with z_f the tracks of
  frame f as complex numbers x + iy, of length 1;
- ``asfm``, affine structure from motion: the least eigenvalue of the 4×4 scatter of the rows of W_f and W_g over its
  trace. Two views of one rigid shape have rank 3: it is 0 for frames that differ by camera and affine deformation only.

Source: Gotardo and Martinez, "Kernel non-rigid structure from motion", ICCV 2011 (kernel PCA as the basis, both
kernels). Departures: (1) σ² is 1, 3 or 10 times the median of E, chosen like K, unless given; (2) the ``asfm`` matrix
is not always positive semidefinite: eigenvectors of negative eigenvalues are not used; (3) not centred, so that the
leading eigenvector is nearly constant and X₀ = [I; 0] starts from the mean shape, as in ``csf1``; (4) solver, choice
of K and d as in ``csf1``.
Runs on the exact compression: E depends on W through inner products of its rows only, the rest as in ``csf1``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nrsfm.methods.base import Monitor, Needs, Problem, Solution
from nrsfm.methods.csf1 import LARGEST_RANK, default_basis_size
from nrsfm.methods.trajectory import Candidate, VariableProjection, choose, clamped, judge, rank_limit, try_ranks
from nrsfm.options import option

WIDTHS = (1.0, 3.0, 10.0)
LEAST_EIGENVALUE = 1e-12  # of the largest: eigenvectors below are rounding


@dataclass(frozen=True)
class KstaOptions:
    """Options of :class:`Ksta`."""

    rank: int | None = option(
        None,
        "Number of basis shapes. Default: of 1 to 12 the one whose shapes, made to reproject exactly, are simplest "
        "(nuclear norm within 3% of the least, then least mean logarithm of the singular values).",
        symbol="K",
        minimum=1,
    )
    basis_size: int | None = option(
        None,
        "Number of eigenvectors of the kernel that the coefficients are made of. Default: a tenth of the frames, at "
        "least 30 or all frames.",
        symbol="d",
        minimum=1,
    )
    kernel: str = option(
        "rik",
        "How unlike two frames are: 'rik' (distance of the 2D shapes up to a turn of the image) or 'asfm' (how far "
        "both are from being views of one rigid shape).",
        choices=("rik", "asfm"),
    )
    width: float | None = option(
        None,
        "Variance σ² of the kernel in units of the median of E over pairs of frames. Default: 1, 3 or 10, chosen as "
        "the rank is.",
        symbol="σ²",
        above=0,
    )
    least_gain: float = option(1e-6, "Stop when an iteration lowers the energy by less than this share.", above=0)
    max_iterations: int = option(100, "Upper bound on iterations, for each K and width.", minimum=1)


def rotation_invariant_distances(flat: np.ndarray) -> np.ndarray:
    """E (F, F) of ``rik`` from W (2F, N)."""
    complex_shapes = flat[0::2] + 1j * flat[1::2]
    norms = np.linalg.norm(complex_shapes, axis=1, keepdims=True)
    unit = complex_shapes / np.where(norms > 0, norms, 1.0)
    return np.maximum(2.0 - 2.0 * np.abs(unit @ unit.conj().T), 0.0)


def affine_distances(flat: np.ndarray) -> np.ndarray:
    """E (F, F) of ``asfm`` from W (2F, N), one row of frames at a time."""
    frames = len(flat) // 2
    gram = (flat @ flat.T).reshape(frames, 2, frames, 2).transpose(0, 2, 1, 3)
    own = gram[np.arange(frames), np.arange(frames)]
    out = np.empty((frames, frames))
    scatter = np.empty((frames, 4, 4))
    scatter[:, 2:, 2:] = own
    for f in range(frames):
        scatter[:, :2, :2] = own[f]
        scatter[:, :2, 2:] = gram[f]
        scatter[:, 2:, :2] = gram[f].transpose(0, 2, 1)
        total = np.einsum("fii->f", scatter)
        out[f] = np.linalg.eigvalsh(scatter)[:, 0] / np.where(total > 0, total, 1.0)
    return np.maximum(out, 0.0)


def kernel_basis(distances: np.ndarray, variance: float, size: int) -> np.ndarray:
    """Ω: leading eigenvectors, at most ``size`` of them, of exp(−E/2σ²), (F, d)."""
    kernel = np.exp(-distances / (2.0 * max(variance, np.finfo(float).tiny)))
    values, vectors = np.linalg.eigh(0.5 * (kernel + kernel.T))
    values, vectors = values[::-1][:size], vectors[:, ::-1][:, :size]
    return np.ascontiguousarray(vectors[:, values > LEAST_EIGENVALUE * values[0]])


class Ksta:
    """Kernel shape trajectories."""

    name = "ksta"
    title = "Kernel shape trajectories"
    year = 2011
    summary = "shape coefficients are smooth in the look of the frames, by a kernel basis"
    assumes = "frames that look alike have like shapes; few deformation modes; cameras that turn"
    cost = "2F²P + F³ once; (dK)³ + F·K²·min(2F, P) per iteration"
    needs = Needs()
    camera_method = "grown"
    denoise = False
    Options = KstaOptions

    def cells(self, options: KstaOptions, points: int, frames: int) -> int:
        """One: the whole point set."""
        return 1

    def solve(self, problem: Problem, options: KstaOptions, rng: np.random.Generator, monitor: Monitor) -> Solution:
        """Damped Gauss-Newton over X, for one K and σ or for all that are compared."""
        rotations, frames = problem.rotations, len(problem.tracks)
        flat = problem.tracks.reshape(2 * frames, -1)
        wanted = options.basis_size or default_basis_size(frames, options.rank)
        size, warnings = clamped(wanted, frames, "basis_size", f"{frames} frames")
        measure = rotation_invariant_distances if options.kernel == "rik" else affine_distances
        distances = measure(flat)
        median = float(np.median(distances[np.triu_indices(frames, 1)]))
        widths = WIDTHS if options.width is None else (options.width,)
        found: list[tuple[Candidate, int, int]] = []
        for width in widths:
            basis = kernel_basis(distances, width * median, size)
            limit, useful = rank_limit(frames, flat.shape[1], basis.shape[1])
            objective = VariableProjection(rotations, flat, basis)

            def tried(rank: int, width: float = width, objective: VariableProjection = objective) -> Candidate:
                fit = objective.minimise(
                    np.eye(objective.basis.shape[1], rank),
                    iterations=options.max_iterations,
                    tolerance=options.least_gain,
                )
                return judge(rotations, flat, fit, width)

            ranks = (
                list(range(1, min(useful, LARGEST_RANK) + 1)) if options.rank is None else [min(options.rank, limit)]
            )
            found += [(candidate, basis.shape[1], limit) for candidate in try_ranks(ranks, tried)]
            monitor((widths.index(width) + 1) / len(widths))
        winner = choose([candidate for candidate, _, _ in found])
        size, limit = next((d, k) for candidate, d, k in found if candidate is winner)
        if options.rank is not None:
            warnings += clamped(options.rank, limit, "rank", f"{frames} frames and {size} eigenvectors")[1]
        best = winner.fit
        return best.solution({"rank": best.rank, "basis_size": size, "width": winner.setting}, warnings)
