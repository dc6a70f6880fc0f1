"""Rotations of many grasps at once, as unit quaternions (x, y, z, w), Bullet's order.

Everything is written out in products and sums of float64 columns: with a matrix library, whose order of
summation differs between machines, a genome would give different poses.
"""

from collections.abc import Iterable, Sequence
from functools import reduce
from operator import add
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Floats: TypeAlias = NDArray[np.float64]


def dot(a: Floats, b: Floats) -> Floats:
    """Return the scalar products (...) of vectors (..., 3)."""
    return np.asarray(a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2])


def running_sum(values: Iterable[float]) -> float:
    """Return the sum of numbers, added from left to right.

    `sum` does the same up to Python 3.11; later ones compensate rounding, which gives other bits.
    """
    return reduce(add, values, 0.0)


def unit(vectors: Floats) -> Floats:
    """Return vectors (..., k) scaled to length one."""
    squares = np.zeros(vectors.shape[:-1])
    for i in range(vectors.shape[-1]):
        squares += vectors[..., i] * vectors[..., i]
    return np.asarray(vectors / np.sqrt(squares)[..., None])


def tangents(normals: Floats) -> tuple[Floats, Floats]:
    """Return unit vectors t and b (n, 3), so that t, b, normal is right-handed.

    Defined for every direction, without a singularity, and continuous except where z changes its
    sign; no field of tangents is continuous all over the sphere. Duff et al. 2017, "Building an
    Orthonormal Basis, Revisited", listing 3.
    """
    x, y, z = normals[..., 0], normals[..., 1], normals[..., 2]
    sign = np.copysign(1.0, z)
    a = -1.0 / (sign + z)
    b = x * y * a
    first = np.stack([1.0 + sign * x * x * a, sign * b, -sign * x], axis=-1)
    second = np.stack([b, sign + y * y * a, -y], axis=-1)
    return first, second


def turned(first: Floats, second: Floats, angles: Floats) -> tuple[Floats, Floats]:
    """Rotate pairs of unit vectors (n, 3) by `angles` (n,) [rad], from first toward second."""
    cosine, sine = np.cos(angles)[..., None], np.sin(angles)[..., None]
    return cosine * first + sine * second, cosine * second - sine * first


def multiply(a: Floats, b: Floats) -> Floats:
    """Return the rotations (n, 4) that turn by `b` first and then by `a`."""
    ax, ay, az, aw = (a[..., i] for i in range(4))
    bx, by, bz, bw = (b[..., i] for i in range(4))
    return np.stack(
        [
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
            aw * bw - ax * bx - ay * by - az * bz,
        ],
        axis=-1,
    )


def rotate(quaternions: Floats, vectors: Floats) -> Floats:
    """Return the vectors (..., 3) turned by unit `quaternions` (..., 4)."""
    pure = np.concatenate([vectors, np.zeros((*vectors.shape[:-1], 1))], axis=-1)
    return multiply(multiply(quaternions, pure), conjugate(quaternions))[..., :3]


def conjugate(quaternions: Floats) -> Floats:
    """Return the inverse rotations (n, 4)."""
    return np.asarray(quaternions * np.array([-1.0, -1.0, -1.0, 1.0]))


def from_frame(x: Floats, y: Floats, z: Floats) -> Floats:
    """Return the quaternions (n, 4), w >= 0, of frames with the columns x, y and z (n, 3).

    Of the four ways to read a quaternion from a matrix, the one that divides by the largest component
    is taken (Shepperd 1978).
    """
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = (np.moveaxis(column, -1, 0) for column in (x, y, z))
    products = np.array(  # 4 q_i q_j of the quaternion q
        [
            [1.0 + xx - yy - zz, yx + xy, zx + xz, yz - zy],
            [yx + xy, 1.0 - xx + yy - zz, zy + yz, zx - xz],
            [zx + xz, zy + yz, 1.0 - xx - yy + zz, xy - yx],
            [yz - zy, zx - xz, xy - yx, 1.0 + xx + yy + zz],
        ]
    )
    largest = np.argmax(np.einsum("iin->in", products), axis=0)
    quaternions = unit(products[largest, :, np.arange(len(largest))])
    return np.asarray(np.where(quaternions[:, 3:] < 0.0, -quaternions, quaternions))


def facing(direction: Sequence[float]) -> Floats:
    """Return a rotation (4,) that turns z into a direction (3,), a unit vector."""
    z = unit(np.array([direction], dtype=np.float64))
    return np.asarray(from_frame(*tangents(z), z)[0])


def from_euler(angles: Floats) -> Floats:
    """Return rotations (n, 4) about fixed axes x, then y, then z by `angles` (n, 3) [rad]."""
    x, y, z = (_about(axis, angles[:, axis]) for axis in range(3))
    return multiply(z, multiply(y, x))


def _about(axis: int, angles: Floats) -> Floats:
    quaternions = np.zeros((len(angles), 4))
    quaternions[:, axis], quaternions[:, 3] = np.sin(angles / 2.0), np.cos(angles / 2.0)
    return quaternions
