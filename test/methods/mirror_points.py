"""Points of a problem as the table that a tracker's own program would write."""

from rotcal_ros.methods.plane_mirror.method import HEADER, KINDS, TIMED


def points_table(problem):
    words = {kind: word for word, kind in KINDS.items()}
    rows = [
        (max(int(p), 0), problem.station_name(int(s)), words[k], int(n), *map(repr, x.tolist()))
        for p, s, k, n, x in zip(
            problem.position, problem.station, problem.kind, problem.nest, problem.xyz, strict=True
        )
    ]
    header = HEADER
    if problem.time is not None:
        rows = [(*row, repr(t)) for row, t in zip(rows, problem.time.tolist(), strict=True)]
        header = TIMED
    return "\n".join(",".join(map(str, row)) for row in [header, *rows]) + "\n"
