# SPDX-License-Identifier: Apache-2.0
"""Feeds the readers of strangers' bytes with changed ones, by atheris: `make fuzz`.

    .venv/bin/python test/fuzz/run.py [TARGET ...] [--seconds N]

Each target has a process of bounded memory. What led it further is kept in
`out/fuzz/TARGET/corpus`, where it begins the next time. What it finds is in
`out/fuzz/TARGET/found`, once for each place it comes from, with the cause beside it. Mend it, and
put the file into `test/fuzz/found/TARGET/`, which a test reads.
"""

import argparse
import hashlib
import logging
import multiprocessing
import random
import resource
import shutil
import sys
import tempfile
import traceback
import warnings
from pathlib import Path

ROOT = Path(__file__).parents[2]
OUT = ROOT / "out" / "fuzz"
# What is watched for branches that are new; what is no Python is not.
WATCHED = ["stack_counter", "mcap", "mcap_ros2", "rosbags", "trimesh", "ruamel", "yaml"]
LONGEST_S = 10  # for one input; chosen
MOST_BYTES = 2 * 10**9  # of memory, on top of what the libraries take; chosen
LONGEST_FILE = 200_000  # bytes; chosen


def main():
    sys.path[:0] = [str(ROOT), str(ROOT / "test")]
    import atheris

    with atheris.instrument_imports(include=WATCHED):
        from fuzz.targets import TARGETS

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("targets", nargs="*", metavar="TARGET",
                        help=f"default: all, one after the other: {', '.join(TARGETS)}")
    parser.add_argument("--seconds", type=int, default=60, metavar="N", help="for each target")
    options = parser.parse_args()
    if unknown := set(options.targets) - set(TARGETS):
        parser.error(f"no target {sorted(unknown)}; expected some of {', '.join(TARGETS)}")
    fork, findings = multiprocessing.get_context("fork"), 0
    for name in options.targets or TARGETS:
        found = OUT / name / "found"
        shutil.rmtree(found, ignore_errors=True)
        process = fork.Process(target=fuzz, args=(name, TARGETS[name], options.seconds))
        process.start()
        process.join()
        # A crash of a library, a hang, or memory ends the process; that input is there too.
        here = [path for path in found.iterdir() if path.suffix != ".txt"]
        print(f"{name}: {len(here)} findings in {found}", flush=True)
        findings += len(here) or process.exitcode != 0
    return 1 if findings else 0


def fuzz(name, target, seconds):
    """Fuzzes one target in a process of its own, which this ends."""
    import atheris

    folder, scratch = OUT / name, Path(tempfile.mkdtemp(prefix="stack_counter_fuzz_"))
    for inner in ("corpus", "seeds", "found"):
        (folder / inner).mkdir(parents=True, exist_ok=True)
    logging.disable()
    warnings.simplefilter("ignore")
    for number, data in enumerate(target.whole_files()):
        (folder / "seeds" / str(number)).write_bytes(data)
        target.outcome(data, scratch)  # loads what is loaded late
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + MOST_BYTES,) * 2)

    def change(data, most_bytes, seed):
        chance = random.Random(seed)
        if chance.random() < 0.5:
            return atheris.Mutate(data, most_bytes)
        return target.change(data, chance)[:most_bytes]

    atheris.Setup(
        [name, str(folder / "corpus"), str(folder / "seeds"), f"-artifact_prefix={folder}/found/",
         f"-max_total_time={seconds}", f"-timeout={LONGEST_S}", f"-max_len={LONGEST_FILE}",
         "-rss_limit_mb=0", "-print_final_stats=1"],
        Collector(name, target, folder / "found", scratch), custom_mutator=change)
    atheris.Fuzz()


class Collector:
    """Reads one input after the other, and keeps those that are findings."""

    def __init__(self, name, target, folder, scratch):
        self.name, self.target, self.folder, self.scratch = name, target, folder, scratch
        self.places = set()

    def __call__(self, data):
        from fuzz.targets import place_of

        try:
            self.target.outcome(data, self.scratch)
        except Exception as error:
            if (place := place_of(error)) in self.places:
                return
            self.places.add(place)
            path = self.folder / hashlib.sha1(data).hexdigest()[:10]
            path.write_bytes(data)
            path.with_suffix(".txt").write_text(traceback.format_exc())
            print(f"{self.name}: {place}: {str(error)[:200]!r}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
