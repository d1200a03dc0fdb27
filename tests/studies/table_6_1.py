"""The thesis' Table 6.1, whole or some rows: python -m tests.studies.table_6_1 [--scene wall two_planes].

Measures what `counterlight study --table-6-1` measures after its study of the shipped rooms at small sizes: simulation,
acquisition and every method at the thesis' sizes. Prints rows of docs/table_6_1.md as they are known. All of it is
simulated.
"""

import argparse

from counterlight.tools.choices import USUAL_PICTURES
from counterlight.tools.study.table_6_1 import HEADER, THESIS_ROWS, cells, measure_at_thesis_size, scenes_of_the_table


def main() -> None:
    scenes = scenes_of_the_table()
    parser = argparse.ArgumentParser(prog="python -m tests.studies.table_6_1", description=__doc__)
    parser.add_argument("--scene", nargs="+", choices=scenes, default=scenes, help="measure these scenes (default all)")
    options = parser.parse_args()
    print(f"| {' | '.join(HEADER)} |\n{'|---' * len(HEADER)}|", flush=True)
    for row in THESIS_ROWS:
        if row.scene in options.scene:
            ours = measure_at_thesis_size(row.scene, USUAL_PICTURES[0])
            print(f"| {' | '.join(cells(row, ours))} |", flush=True)


if __name__ == "__main__":
    main()
