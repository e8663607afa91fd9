"""Forward and inverse kinematics of Universal Robots arms by their Denavit-Hartenberg parameters. Pure.

Lengths in metres, angles in radians. A pose is [x, y, z, rx, ry, rz] with a rotation vector, as the controllers write
it; inside, it is a `Frame` of a rotation matrix (nine numbers, row by row) and a position.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

__all__ = [
    "MODELS",
    "Frame",
    "Model",
    "flange",
    "frame_of",
    "inverse",
    "inverted",
    "jacobian",
    "pose_of",
    "product",
    "rotated",
    "rotation_between",
    "rotation_of",
    "solve",
]

Vector = tuple[float, float, float]
Matrix = tuple[float, float, float, float, float, float, float, float, float]

IDENTITY: Final[Matrix] = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


class Model(NamedTuple):
    """One size of arm."""

    name: str
    d: tuple[float, float, float, float, float, float]
    a: tuple[float, float, float, float, float, float]


_ALPHA: Final = (math.pi / 2, 0.0, 0.0, math.pi / 2, -math.pi / 2, 0.0)
_TWIST: Final = tuple((round(math.cos(alpha)), round(math.sin(alpha))) for alpha in _ALPHA)


def _model(name: str, d1: float, a2: float, a3: float, d4: float, d5: float, d6: float) -> Model:
    return Model(name, (d1, 0.0, 0.0, d4, d5, d6), (0.0, a2, a3, 0.0, 0.0, 0.0))


MODELS: Final = {
    model.name.lower(): model
    for model in (
        _model("UR3", 0.1519, -0.24365, -0.21325, 0.11235, 0.08535, 0.0819),
        _model("UR5", 0.089159, -0.425, -0.39225, 0.10915, 0.09465, 0.0823),
        _model("UR10", 0.1273, -0.612, -0.5723, 0.163941, 0.1157, 0.0922),
        _model("UR3e", 0.15185, -0.24355, -0.2132, 0.13105, 0.08535, 0.0921),
        _model("UR5e", 0.1625, -0.425, -0.3922, 0.1333, 0.0997, 0.0996),
        _model("UR10e", 0.1807, -0.6127, -0.57155, 0.17415, 0.11985, 0.11655),
    )
}
"""Universal Robots' published parameters ("DH parameters for calculations of kinematics and dynamics")."""


class Frame(NamedTuple):
    """A place and an attitude."""

    rotation: Matrix
    position: Vector


def _times(a: Matrix, b: Matrix) -> Matrix:
    a0, a1, a2, a3, a4, a5, a6, a7, a8 = a
    b0, b1, b2, b3, b4, b5, b6, b7, b8 = b
    return (
        a0 * b0 + a1 * b3 + a2 * b6,
        a0 * b1 + a1 * b4 + a2 * b7,
        a0 * b2 + a1 * b5 + a2 * b8,
        a3 * b0 + a4 * b3 + a5 * b6,
        a3 * b1 + a4 * b4 + a5 * b7,
        a3 * b2 + a4 * b5 + a5 * b8,
        a6 * b0 + a7 * b3 + a8 * b6,
        a6 * b1 + a7 * b4 + a8 * b7,
        a6 * b2 + a7 * b5 + a8 * b8,
    )


def rotated(m: Matrix, v: Sequence[float]) -> Vector:
    """A vector turned by a rotation."""
    x, y, z = v
    return (
        m[0] * x + m[1] * y + m[2] * z,
        m[3] * x + m[4] * y + m[5] * z,
        m[6] * x + m[7] * y + m[8] * z,
    )


def _transposed(m: Matrix) -> Matrix:
    return (m[0], m[3], m[6], m[1], m[4], m[7], m[2], m[5], m[8])


def product(first: Frame, second: Frame) -> Frame:
    """`second`, given in `first`, seen from where `first` is given: URScript's pose_trans."""
    x, y, z = rotated(first.rotation, second.position)
    px, py, pz = first.position
    return Frame(_times(first.rotation, second.rotation), (px + x, py + y, pz + z))


def inverted(frame: Frame) -> Frame:
    """The way back: URScript's pose_inv."""
    back = _transposed(frame.rotation)
    x, y, z = rotated(back, frame.position)
    return Frame(back, (-x, -y, -z))


def rotation_of(vector: Sequence[float]) -> Matrix:
    """The matrix of a rotation vector."""
    rx, ry, rz = vector
    angle = math.sqrt(rx * rx + ry * ry + rz * rz)
    if angle < 1e-12:
        return IDENTITY
    x, y, z = rx / angle, ry / angle, rz / angle
    c, s = math.cos(angle), math.sin(angle)
    t = 1.0 - c
    return (
        t * x * x + c,
        t * x * y - s * z,
        t * x * z + s * y,
        t * x * y + s * z,
        t * y * y + c,
        t * y * z - s * x,
        t * x * z - s * y,
        t * y * z + s * x,
        t * z * z + c,
    )


def _vector_of(m: Matrix) -> Vector:
    """The rotation vector of a matrix, of an angle of 0 to pi."""
    x, y, z = m[7] - m[5], m[2] - m[6], m[3] - m[1]
    sine = math.sqrt(x * x + y * y + z * z) / 2
    cosine = (m[0] + m[4] + m[8] - 1) / 2
    angle = math.atan2(sine, cosine)
    if sine > 1e-7:
        scale = angle / (2 * sine)
        return x * scale, y * scale, z * scale
    if cosine > 0:
        return x / 2, y / 2, z / 2
    # Half a turn: the axis stands in the diagonal, its signs in the largest column.
    diagonal = (m[0], m[4], m[8])
    k = diagonal.index(max(diagonal))
    length = math.sqrt(max((diagonal[k] + 1) / 2, 0.0))
    axis = [(m[3 * i + k] + m[3 * k + i]) / (4 * length) for i in range(3)]
    axis[k] = length
    return axis[0] * angle, axis[1] * angle, axis[2] * angle


def rotation_between(start: Frame, end: Frame) -> Vector:
    """The rotation vector, in base coordinates, that turns one attitude into the other."""
    return _vector_of(_times(end.rotation, _transposed(start.rotation)))


def frame_of(pose: Sequence[float]) -> Frame:
    """The frame of a pose."""
    x, y, z, *rotation = pose
    return Frame(rotation_of(rotation), (x, y, z))


def pose_of(frame: Frame) -> list[float]:
    """The pose of a frame."""
    return [*frame.position, *_vector_of(frame.rotation)]


def _frames(model: Model, q: Sequence[float]) -> list[Frame]:
    """The base, and the frame after each joint."""
    frames = [Frame(IDENTITY, (0.0, 0.0, 0.0))]
    frame = frames[0]
    for angle, d, a, (ca, sa) in zip(q, model.d, model.a, _TWIST, strict=True):
        c, s = math.cos(angle), math.sin(angle)
        link = Frame((c, -s * ca, s * sa, s, c * ca, -c * sa, 0.0, float(sa), float(ca)), (a * c, a * s, d))
        frame = product(frame, link)
        frames.append(frame)
    return frames


def flange(model: Model, q: Sequence[float]) -> Frame:
    """Where the tool flange is."""
    return _frames(model, q)[-1]


def jacobian(model: Model, q: Sequence[float], tool: Frame) -> tuple[Frame, list[list[float]]]:
    """Where the tool's centre is, and how its linear and angular velocity follow from the joints' (6 rows)."""
    frames = _frames(model, q)
    tip = product(frames[-1], tool)
    tx, ty, tz = tip.position
    rows: list[list[float]] = [[] for _ in range(6)]
    for rotation, (px, py, pz) in frames[:-1]:
        zx, zy, zz = rotation[2], rotation[5], rotation[8]
        dx, dy, dz = tx - px, ty - py, tz - pz
        for row, value in zip(rows, (zy * dz - zz * dy, zz * dx - zx * dz, zx * dy - zy * dx, zx, zy, zz), strict=True):
            row.append(value)
    return tip, rows


def solve(rows: list[list[float]], right: Sequence[float], damping: float = 0.0) -> list[float]:
    """The least-squares solution x of rows * x = right, damped: (JᵀJ + damping² I) x = Jᵀ right."""
    n = len(rows[0])
    square = damping * damping
    augmented = [
        [sum(row[i] * row[j] for row in rows) + (square if i == j else 0.0) for j in range(n)]
        + [sum(row[i] * value for row, value in zip(rows, right, strict=True))]
        for i in range(n)
    ]
    for column in range(n):
        pivot = max(range(column, n), key=lambda index: abs(augmented[index][column]))
        augmented[column], augmented[pivot] = augmented[pivot], augmented[column]
        top = augmented[column]
        lead = top[column]
        if abs(lead) < 1e-18:
            continue
        for below in augmented[column + 1 :]:
            factor = below[column] / lead
            if factor:
                for index in range(column, n + 1):
                    below[index] -= factor * top[index]
    found = [0.0] * n
    for column in range(n - 1, -1, -1):
        row = augmented[column]
        if abs(row[column]) >= 1e-18:
            rest = sum(row[index] * found[index] for index in range(column + 1, n))
            found[column] = (row[n] - rest) / row[column]
    return found


def inverse(
    model: Model,
    target: Frame,
    near: Sequence[float],
    tool: Frame,
    *,
    position_error: float = 1e-8,
    rotation_error: float = 1e-8,
    rounds: int = 60,
) -> list[float] | None:
    """Joint positions, the closest that Newton's method finds from `near`; None where the target is out of reach."""
    q = list(near)
    for _ in range(rounds):
        tip, rows = jacobian(model, q, tool)
        miss = [end - start for end, start in zip(target.position, tip.position, strict=True)]
        turn = rotation_between(tip, target)
        far, twisted = math.hypot(*miss), math.hypot(*turn)
        if far <= position_error and twisted <= rotation_error:
            return q
        step = solve(rows, [*miss, *turn], damping=min(1e-2, 0.1 * (far + twisted)))
        longest = max(abs(value) for value in step)
        scale = min(1.0, 0.5 / longest) if longest > 0 else 0.0
        q = [value + scale * change for value, change in zip(q, step, strict=True)]
    return None
