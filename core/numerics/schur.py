"""The arrow-shaped normal equations of views that share something: the shared part solved first, then each view's own.

Camera coordinates of a step: log f (fx and fy together), log(fx/fy), then cx, cy, k1, k2, p1, p2, or what other lens
models have instead (`core.geometry.LENS_PARAMETERS`); a pose has six. A
`Sharing` says which of them all views have in common and which each has by itself. With shared coordinates s and a
view's own l, the normal equations are an arrow,

    [A  C₁ C₂ ...] [s ]   [a ]
    [C₁ᵀ L₁      ] [l₁] = [b₁]
    [C₂ᵀ    L₂   ] [l₂]   [b₂]

whose head is solved first: (A - Σ Cᵢ Lᵢ⁻¹ Cᵢᵀ) s = a - Σ Cᵢ Lᵢ⁻¹ bᵢ, and then lᵢ = Lᵢ⁻¹ (bᵢ - Cᵢᵀ s). The cost is
linear in the number of views.

References: B. Triggs, P. McLauchlan, R. Hartley, A. Fitzgibbon, "Bundle adjustment: a modern synthesis", 1999,
section 6.1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from core.jit import jit


@dataclass(frozen=True, slots=True)
class Sharing:
    """Which camera coordinates views have in common, and which each has of its own in addition to its pose."""

    common: tuple[int, ...]
    own: tuple[int, ...]
    camera: int = 8
    """Coordinates of the camera, whoever has them; the pose's six follow."""

    @property
    def local(self) -> tuple[int, ...]:
        """All that a view has of its own, its pose last."""
        return (*self.own, *range(self.camera, self.camera + 6))


def shared_camera(camera: int) -> Sharing:
    """Return the sharing of all `camera` coordinates of a lens model."""
    return Sharing(tuple(range(camera)), (), camera)


def free_focal(camera: int) -> Sharing:
    """Return the sharing of all of a lens model's coordinates but the focal length."""
    return Sharing(tuple(range(1, camera)), (0,), camera)


SHARED_CAMERA = shared_camera(8)
KNOWN = Sharing(common=(), own=())


@dataclass(frozen=True, slots=True)
class ArrowheadEquations:
    """Normal equations with the views' own coordinates eliminated.

    `head` and `right` are what is left for the common ones, `by_common` = Lᵢ⁻¹ Cᵢᵀ, `alone` = Lᵢ⁻¹ bᵢ and `own` = Lᵢ.
    """

    head: Float[np.ndarray, "s s"]
    right: Float[np.ndarray, " s"]
    by_common: Float[np.ndarray, "m l s"]
    alone: Float[np.ndarray, "m l"]
    own: Float[np.ndarray, "m l l"]

    def solve(self) -> tuple[Float[np.ndarray, " s"], Float[np.ndarray, "m l"]]:
        """Return the common step and the views' own.

        Raises LinAlgError where the views leave the common one open.
        """
        if not len(self.right):
            return self.right, self.alone
        common = np.linalg.solve(self.head, self.right)
        return common, self.alone - self.by_common @ common

    def longest(self, common: Float[np.ndarray, " s"], own: Float[np.ndarray, "m l"]) -> float:
        """Return the longest of a step's parts, in units of its own uncertainty; for equations without damping."""
        lengths = np.einsum("ml,ml->m", own, (self.own @ own[:, :, None])[:, :, 0])
        return math.sqrt(max(float(common @ self.head @ common), float(lengths.max()), 0.0))


def arrow(
    products: Float[np.ndarray, "m q q"],
    parameters: Float[np.ndarray, "m p"],
    sharing: Sharing,
    weight: float,
    prior: tuple[Float[np.ndarray, "s s"], Float[np.ndarray, " s"]] | None = None,
    damping: float = 0.0,
) -> ArrowheadEquations:
    """Eliminate what views have of their own from `residuals.normal_equations` times `weight`.

    `prior` is its normal matrix and right-hand side, added to the common part. A view without information stays where
    it is. Damping adds that share of the diagonal.
    """
    size = len(sharing.common)
    A, a = prior if prior is not None else (np.zeros((size, size)), np.zeros(size))
    return ArrowheadEquations(
        *_eliminated(
            products,
            parameters,
            np.array(sharing.common, dtype=np.intp),
            np.array(sharing.local, dtype=np.intp),
            weight,
            damping,
            A,
            a,
        )
    )


@jit("f8[:, :, ::1], f8[:, ::1], i8[::1], i8[::1], f8, f8, f8[:, ::1], f8[::1]")
def _eliminated(
    products: Float[np.ndarray, "m q q"],
    parameters: Float[np.ndarray, "m p"],
    common: Int[np.ndarray, " s"],
    local: Int[np.ndarray, " l"],
    weight: float,
    damping: float,
    A: Float[np.ndarray, "s s"],
    a: Float[np.ndarray, " s"],
) -> tuple[
    Float[np.ndarray, "s s"],
    Float[np.ndarray, " s"],
    Float[np.ndarray, "m l s"],
    Float[np.ndarray, "m l"],
    Float[np.ndarray, "m l l"],
]:
    views, s, size, width = len(products), len(common), len(local), products.shape[1]
    last = width - 1  # the residuals' row and column
    head, right = A * (1.0 + damping * np.eye(s)), a.copy()
    by_common, alone, own = np.zeros((views, size, s)), np.zeros((views, size)), np.zeros((views, size, size))
    N, factor, y = np.empty((width, width)), np.empty((size, size)), np.empty((size, s + 1))
    for i in range(views):
        fx, fy = parameters[i, 0], parameters[i, 1]
        # From fx, fy to their common logarithm and that of their ratio: rows, then columns.
        for j in range(width):
            for k in range(width):
                N[j, k] = weight * products[i, j, k]
        for k in range(width):
            u, v = fx * N[0, k], fy * N[1, k]
            N[0, k], N[1, k] = u + v, 0.5 * (u - v)
        for j in range(width):
            u, v = fx * N[j, 0], fy * N[j, 1]
            N[j, 0], N[j, 1] = u + v, 0.5 * (u - v)
        for j in range(size):
            for k in range(size):
                own[i, j, k] = N[local[j], local[k]]
        # Cholesky's factor of L with damping; without one, the view has nothing to say.
        sound = True
        for j in range(size):
            for k in range(j + 1):
                total = own[i, j, k]
                if j == k:
                    total *= 1.0 + damping
                for q in range(k):
                    total -= factor[j, q] * factor[k, q]
                if j > k:
                    factor[j, k] = total / factor[k, k]
                elif total > 1e-15 * own[i, j, j]:
                    factor[j, j] = np.sqrt(total)
                else:
                    sound = False
                    factor[j, j] = 1.0
        if not sound:
            own[i] = np.eye(size)
            continue
        # y = factor⁻¹ [Cᵀ b], so that C L⁻¹ Cᵀ = yᵀ y.
        for c in range(s + 1):
            column = common[c] if c < s else last
            for j in range(size):
                total = N[local[j], column]
                for q in range(j):
                    total -= factor[j, q] * y[q, c]
                y[j, c] = total / factor[j, j]
        for c in range(s):
            for d in range(s):
                total = N[common[c], common[d]]
                if c == d:
                    total *= 1.0 + damping
                for j in range(size):
                    total -= y[j, c] * y[j, d]
                head[c, d] += total
            total = N[common[c], last]
            for j in range(size):
                total -= y[j, c] * y[j, s]
            right[c] += total
        for c in range(s + 1):
            for j in range(size - 1, -1, -1):
                total = y[j, c]
                for q in range(j + 1, size):
                    total -= factor[q, j] * y[q, c]
                y[j, c] = total / factor[j, j]
            for j in range(size):
                if c < s:
                    by_common[i, j, c] = y[j, c]
                else:
                    alone[i, j] = y[j, c]
    return head, right, by_common, alone, own
