"""Convex pieces of a curved body by coacd, in a process of its own: bounded in time, memory and threads. Metres.

coacd measures how concave a piece is at sampled points and moves surfaces: who calls this checks the result.
"""

from __future__ import annotations

import io
import os
import resource
import subprocess
import sys

import numpy as np

#: Address space of the process [bytes].
_MEMORY = 4 * 2**30
#: Of coacd: corners of a piece, its own smallest and largest threshold.
_CORNERS, _FINEST, _COARSEST = 64, 0.01, 1.0


def decomposed(
    vertices: np.ndarray, triangles: np.ndarray, concavity: float, most: int, seconds: float
) -> list[np.ndarray] | None:
    """Return the corners of convex pieces, or None if coacd found none within the time; the same input gives the same pieces.

    Args:
        vertices: Shape (v, 3). [m]
        triangles: Shape (t, 3), integers
        concavity: How concave a piece may be [m].
        seconds: Longest time of the process [s].
    """
    size = float(np.ptp(vertices, axis=0).max())
    threshold = min(max(2.0 * concavity / size, _FINEST), _COARSEST)
    sent = io.BytesIO()
    np.savez(sent, vertices=vertices, triangles=triangles, threshold=threshold, most=most)
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    try:
        done = subprocess.run(
            [sys.executable, "-m", "construction_twin.work.convex_decomposition"],
            input=sent.getvalue(), capture_output=True, timeout=seconds, env=environment, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return None
    if done.returncode != 0:
        return None
    found = np.load(io.BytesIO(done.stdout))
    return [found[f"piece{number}"] for number in range(len(found.files))]


def _main() -> None:
    """Read a mesh from standard input, write its pieces to standard output."""
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
    # coacd writes what it does to standard output
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    import coacd  # noqa: PLC0415 (an extra of the set-up, needed by this process only)

    given = np.load(io.BytesIO(sys.stdin.buffer.read()))
    coacd.set_log_level("error")
    found = coacd.run_coacd(
        coacd.Mesh(given["vertices"], given["triangles"].astype(np.int32)),
        threshold=float(given["threshold"]), max_convex_hull=int(given["most"]), preprocess_mode="auto",
        resolution=2000, mcts_iterations=60, decimate=True, max_ch_vertex=_CORNERS, seed=1,
    )  # fmt: skip
    np.savez(out, **{f"piece{number}": piece for number, (piece, _) in enumerate(found)})
    out.close()


if __name__ == "__main__":
    _main()
