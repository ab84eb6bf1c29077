"""DH parameters from joint axes, by the common normals of neighbours.

Axes are taken at a home configuration h, all in one frame; z_{i-1} is axis i, its sense the encoder's. Frame i has its
origin where the common normal of axes i and i+1 meets axis i+1, and x_i along that normal:

    α_i  from z_{i-1} to z_i about x_i          a_i  along x_i, from axis i to axis i+1
    θ_i  from x_{i-1} to x_i about z_{i-1}      d_i  along z_{i-1}, from origin i-1 to the normal's foot on axis i

with offset_i = θ_i - h_i, and angles within π of the nominal's, from -175° to 185° without one. x_i and -x_i describe
the same arm: those are taken that are next to the nominal; without a nominal a_i > 0, and α_i > 0 where the axes
intersect (`equal_descriptions`).

Near parallel neighbours (decided on the predicted uncertainty of the foot) have Hayati's form instead: d_i keeps the
nominal's value, origin i lies where axis i+1 pierces the plane across axis i, x' points there from axis i, and β_i is
the remaining rotation about y after α_i about x'. Where the two axes are one line, x' is not determined either: θ_i
then keeps the nominal's value, or zero.

No pose determines θ_1 and d_1 (equivalent to the base), nor any parameter of the last joint (equivalent to the tool).
These are conventions.

References: J. Denavit, R. S. Hartenberg, J. Applied Mechanics 22 (1955) 215-221; S. A. Hayati, "Robot arm geometric
link parameter estimation", IEEE CDC 1983, 10.1109/CDC.1983.269783.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from core.geometry import hat, perpendicular, so3_exp, transform
from core.kinematics.dh import Chain, frames
from core.kinematics.equal_descriptions import nearest_description, positive_description, unwrapped

_PARALLEL = 1e-9  # sine of the angle below which there is no common normal in double precision


@dataclass(frozen=True, slots=True)
class Axes:
    """Joint axes in one frame at one configuration: a point (mm) and a direction of each."""

    points: Float[np.ndarray, "j 3"]
    directions: Float[np.ndarray, "j 3"]

    def __len__(self) -> int:
        return len(self.points)

    def bases(self) -> Float[np.ndarray, "j 3 2"]:
        """Return two directions across each axis."""
        found = [np.column_stack([perpendicular(n), hat(n) @ perpendicular(n)]) for n in self.directions]
        return np.array(found).reshape(-1, 3, 2)


@dataclass(frozen=True, slots=True)
class LinkForm:
    """How a link is described: by Hayati's form or not, with x or -x (`sign`), and whether its axes are one line."""

    parallel: bool = False
    sign: float = 1.0
    coincident: bool = False


@dataclass(frozen=True, slots=True)
class DhDescription:
    """Parameters, rows in the order of `JOINT_PARAMETERS`; the base in the axes' frame; which are not conventions."""

    parameters: Float[np.ndarray, "j 5"]
    T_frame_base: Float[np.ndarray, "4 4"]
    identifiable: Bool[np.ndarray, "j 5"]


def feet(axes: Axes, link: int) -> tuple[float, float, float]:
    """Return where the common normal of axes `link` and `link + 1` meets them, mm along each from its point, and sin α.

    Infinite where the axes are parallel.
    """
    n, m = axes.directions[link], axes.directions[link + 1]
    across = hat(n) @ m
    sine = float(np.linalg.norm(across))
    if sine < _PARALLEL:
        return math.inf, math.inf, sine
    between = axes.points[link + 1] - axes.points[link]
    first = float(hat(between) @ m @ across) / sine**2
    second = float(hat(between) @ n @ across) / sine**2
    return first, second, sine


def describe(
    axes: Axes,
    home: Float[np.ndarray, " j"],
    forms: Sequence[LinkForm],
    nominal: Chain | None,
    height_mm: float = 0.0,
) -> DhDescription:
    """Return the DH parameters in given forms, one for each link but the last.

    `home` are the joint angles (rad) at which the axes are. The nominal gives what is convention, zero without one.
    Where all axes are parallel, the base stands `height_mm` along the first from its point.
    """
    given = _given(axes, nominal)
    first = _walk(axes, home, forms, given, height_mm if all(form.parallel for form in forms) else 0.0)
    # Where the first axes are parallel, the base's height shows in the d of the first pair that is not.
    lead = next((i for i, form in enumerate(forms) if not form.parallel), len(forms))
    if 0 < lead < len(forms):
        shift = 0.0
        for _ in range(3):
            shift += first.parameters[lead, 2] - given[lead, 2]
            first = _walk(axes, home, forms, given, shift)
        first.identifiable[lead, 2] = False
    return replace(first, parameters=unwrapped(first.parameters, None if nominal is None else given))


def choose_signs(
    axes: Axes,
    home: Float[np.ndarray, " j"],
    parallel: Sequence[bool],
    coincident: Sequence[bool],
    nominal: Chain | None,
    sigma_a: Float[np.ndarray, " l"],
) -> tuple[LinkForm, ...]:
    """Return the forms with each x chosen next to the nominal; without one so that a > 0, or α > 0 where a does not
    differ from zero significantly, by its standard uncertainty `sigma_a` (mm).
    """
    forms = [LinkForm(p, 1.0, c) for p, c in zip(parallel, coincident, strict=True)]
    given = _given(axes, nominal)
    parameters = _walk(axes, home, forms, given, 0.0).parameters
    if nominal is None:
        reversals = positive_description(parameters, sigma_a, coincident)
    else:
        reversals = nearest_description(parameters, given, coincident)
    return tuple(
        form if form.coincident else LinkForm(form.parallel, -1.0 if reverse else 1.0)
        for form, reverse in zip(forms, reversals.tolist(), strict=True)
    )


def axes_of(
    chain: Chain, home: Float[np.ndarray, " j"], T_frame_base: Float[np.ndarray, "4 4"] | None = None
) -> Axes:
    """Return a chain's joint axes at joint angles `home` (rad), in the base's frame or another."""
    T = frames(chain, home[None])[0]
    T = T if T_frame_base is None else T_frame_base @ T
    return Axes(np.ascontiguousarray(T[:-1, :3, 3]), np.ascontiguousarray(T[:-1, :3, 2]))


def reparametrise(chain: Chain, parallel: Sequence[bool], nominal: Chain | None) -> Chain:
    """Return the same arm in the conventions of an identification, so that the two can be compared.

    Parameters that no pose determines take the nominal's values. Where `parallel` (for each joint, or each but the
    last) is true, the link has Hayati's form with the nominal's d. Base and tool then differ from the chain's own.
    """
    home, links = np.zeros(len(chain)), len(chain) - 1
    axes = axes_of(chain, home)
    forms = choose_signs(axes, home, list(parallel)[:links], [False] * links, nominal, np.zeros(links))
    return Chain.from_array(describe(axes, home, forms, nominal).parameters)


def _given(axes: Axes, nominal: Chain | None) -> Float[np.ndarray, "j 5"]:
    return np.zeros((len(axes), 5)) if nominal is None else nominal.as_array()


def _walk(
    axes: Axes,
    home: Float[np.ndarray, " j"],
    forms: Sequence[LinkForm],
    given: Float[np.ndarray, "j 5"],
    lift: float,
) -> DhDescription:
    """Go from the base to the end; `lift` moves the first origin along a first axis whose foot is not determined."""
    count = len(axes)
    P = given.copy()
    P[:, 4] = 0.0
    identifiable = np.zeros((count, 5), dtype=np.bool_)
    base = np.eye(4)
    x, origin = np.zeros(3), np.zeros(3)
    for i in range(count - 1):
        form, z = forms[i], axes.directions[i]
        if form.parallel:
            start = axes.points[0] + lift * z if i == 0 else origin + given[i, 2] * z
            if i == 0 and form.coincident:
                x = perpendicular(z)
            turned, found, origin_next, x_next = _hayati(
                axes, i, form, start, _by_angle(x, z, home[i] + given[i, 3])
            )
            P[i, [0, 1, 4]] = found
            identifiable[i] = (True, True, False, i > 0 and not form.coincident, True)
            foot = start
        else:
            first, second, _ = feet(axes, i)
            foot = axes.points[i] + first * z
            origin_next = axes.points[i + 1] + second * axes.directions[i + 1]
            across = hat(z) @ axes.directions[i + 1]
            turned = x_next = form.sign * across / np.linalg.norm(across)
            P[i, 0] = (origin_next - foot) @ turned
            P[i, 1] = math.atan2(float(across @ turned), float(z @ axes.directions[i + 1]))
            identifiable[i] = (True, True, i > 0, i > 0, False)
            if i > 0:
                P[i, 2] = (foot - origin) @ z
        if i == 0:
            x = so3_exp(-(home[0] + given[0, 3]) * z) @ turned
            base = transform(np.column_stack([x, hat(z) @ x, z]), foot - given[0, 2] * z)
        elif identifiable[i, 3]:
            theta = math.atan2(float(hat(x) @ turned @ z), float(x @ turned))
            P[i, 3] = theta - float(home[i])
        x, origin = x_next, origin_next
    if count == 1:
        z = axes.directions[0]
        x = so3_exp(-(home[0] + given[0, 3]) * z) @ perpendicular(z)
        base = transform(np.column_stack([x, hat(z) @ x, z]), axes.points[0] - given[0, 2] * z)
    P[-1, 4] = given[-1, 4]
    return DhDescription(P, base, identifiable)


def _hayati(
    axes: Axes, i: int, form: LinkForm, start: Float[np.ndarray, "3"], fallback: Float[np.ndarray, "3"]
) -> tuple[
    Float[np.ndarray, "3"], tuple[float, float, float], Float[np.ndarray, "3"], Float[np.ndarray, "3"]
]:
    """Return x', (a, α, β), the next origin and the next x of a link in Hayati's form."""
    z, m, point = axes.directions[i], axes.directions[i + 1], axes.points[i + 1]
    origin = point + m * (float((start - point) @ z) / float(m @ z))
    out = origin - start
    if form.coincident:
        turned = fallback if i else perpendicular(z)
    else:
        turned = form.sign * out / np.linalg.norm(out)
    turned = turned - z * (z @ turned)
    turned /= np.linalg.norm(turned)
    frame = np.column_stack([turned, hat(z) @ turned, z])
    # Rx(α) Ry(β) z = (sin β, -sin α cos β, cos α cos β)
    v = frame.T @ m
    alpha, beta = math.atan2(-v[1], v[2]), math.asin(min(max(v[0], -1.0), 1.0))
    if v[2] < 0.0:  # near half a turn, of either sign: no jump between them
        alpha = math.pi + math.atan2(v[1], -v[2])
    x = np.array([math.cos(beta), math.sin(alpha) * math.sin(beta), -math.cos(alpha) * math.sin(beta)])
    return turned, (float(out @ turned), alpha, beta), origin, frame @ x


def _by_angle(x: Float[np.ndarray, "3"], z: Float[np.ndarray, "3"], angle: float) -> Float[np.ndarray, "3"]:
    return np.asarray(so3_exp(angle * z) @ x)
