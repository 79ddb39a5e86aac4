"""Points of a problem as the table that a tracker's own program would write."""

from rotcal_ros.catalogue.plane_mirror.table import HEADER, KINDS


def points_table(problem):
    words = {kind: word for word, kind in KINDS.items()}
    rows = [
        (max(int(p), 0), problem.station_name(int(s)), words[k], int(n), *map(repr, x.tolist()))
        for p, s, k, n, x in zip(
            problem.position, problem.station, problem.kind, problem.nest, problem.xyz, strict=True
        )
    ]
    return "\n".join(",".join(map(str, row)) for row in [HEADER, *rows]) + "\n"
