"""The spikes below which a spiking network costs less than the dense one of its size, for each price list.

Draws the figure of the docs: python benchmarks/break_even.py -o docs/images/break-even.png
"""

import argparse
from pathlib import Path

from neurotact_parts.studies.comparison.break_even import drawn, table

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Break-even of spiking and dense networks.")
    parser.add_argument("-o", type=Path, required=True, metavar="PNG")
    rows = table()
    print(rows.round(2).to_string(index=False))
    drawn(rows).savefig(parser.parse_args().o, dpi=150)
