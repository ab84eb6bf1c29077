"""The arrow-shaped normal equations of views that share something: the shared part solved first, then each view's own.

Camera coordinates of a step: log f (fx and fy together), log(fx/fy), then cx, cy, k1, k2, p1, p2; a pose has six. A
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

from core.compiled import compiled


@dataclass(frozen=True, slots=True)
class Sharing:
    """Which camera coordinates views have in common, and which each has of its own beside its pose."""

    common: tuple[int, ...]
    own: tuple[int, ...]

    @property
    def local(self) -> tuple[int, ...]:
        """All that a view has of its own, its pose last."""
        return (*self.own, *range(8, 14))


TIED = Sharing(common=tuple(range(8)), own=())
FREE_FOCAL = Sharing(common=tuple(range(1, 8)), own=(0,))
KNOWN = Sharing(common=(), own=())


@dataclass(frozen=True, slots=True)
class Arrow:
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
    products: Float[np.ndarray, "m 15 15"],
    parameters: Float[np.ndarray, "m 9"],
    sharing: Sharing,
    weight: float,
    prior: tuple[Float[np.ndarray, "s s"], Float[np.ndarray, " s"]] | None = None,
    damping: float = 0.0,
) -> Arrow:
    """Eliminate what views have of their own from `view_residuals.normal_equations` times `weight`.

    `prior` is its normal matrix and right-hand side, added to the common part. A view without information stays where
    it is. Damping adds that share of the diagonal.
    """
    size = len(sharing.common)
    A, a = prior if prior is not None else (np.zeros((size, size)), np.zeros(size))
    return Arrow(
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


@compiled
def _eliminated(
    products: Float[np.ndarray, "m 15 15"],
    parameters: Float[np.ndarray, "m 9"],
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
    views, s, size = len(products), len(common), len(local)
    head, right = A * (1.0 + damping * np.eye(s)), a.copy()
    by_common, alone, own = np.zeros((views, size, s)), np.zeros((views, size)), np.zeros((views, size, size))
    N, factor, y = np.empty((15, 15)), np.empty((size, size)), np.empty((size, s + 1))
    for i in range(views):
        fx, fy = parameters[i, 0], parameters[i, 1]
        # From fx, fy to their common logarithm and that of their ratio: rows, then columns.
        for j in range(15):
            for k in range(15):
                N[j, k] = weight * products[i, j, k]
        for k in range(15):
            u, v = fx * N[0, k], fy * N[1, k]
            N[0, k], N[1, k] = u + v, 0.5 * (u - v)
        for j in range(15):
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
            column = common[c] if c < s else 14
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
            total = N[common[c], 14]
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
