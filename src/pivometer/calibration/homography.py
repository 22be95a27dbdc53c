"""Maps between a plane and its image, by the normalised direct linear transform."""

import numpy as np

from pivometer._arrays import Floats


def homography(source: Floats, target: Floats) -> Floats:
    """Return H with target ~ H source, shape (3, 3), by the normalised direct linear transform.

    Parameters
    ----------
    source, target
        At least four points each, shape (n, 2), any unit.

    References
    ----------
    Hartley and Zisserman, algorithm 4.2 (the paper's reference [15]).

    Examples
    --------
    >>> square = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    >>> H = homography(square, 2 * square + [5, 7])
    >>> bool(np.allclose(H / H[2, 2], [[2, 0, 5], [0, 2, 7], [0, 0, 1]]))
    True
    """
    T1, T2 = normalising_similarity(source), normalising_similarity(target)
    a = source @ T1[:2, :2].T + T1[:2, 2]
    b = target @ T2[:2, :2].T + T2[:2, 2]
    one = np.concatenate([a, np.ones((len(a), 1))], axis=1)
    zero = np.zeros_like(one)
    rows = np.concatenate(
        [
            np.concatenate([one, zero, -b[:, :1] * one], axis=1),
            np.concatenate([zero, one, -b[:, 1:] * one], axis=1),
        ]
    )
    H = np.linalg.eigh(rows.T @ rows)[1][:, 0].reshape(3, 3)
    result: Floats = np.linalg.inv(T2) @ H @ T1
    return result


def normalising_similarity(points: Floats) -> Floats:
    """Return the 3×3 similarity that brings points to centroid 0 and mean distance √2.

    References
    ----------
    Hartley, "In defense of the eight-point algorithm", doi:10.1109/34.601246.
    """
    centre = points.mean(axis=0)
    distance = float(np.mean(np.linalg.norm(points - centre, axis=1)))
    scale = np.sqrt(2) / distance if distance > 0 else 1.0
    return np.array([[scale, 0, -scale * centre[0]], [0, scale, -scale * centre[1]], [0, 0, 1]])
