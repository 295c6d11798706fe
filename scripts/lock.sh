#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Writes requirements.lock: what .venv has, each package with the hashes of its files.
#
# Run by `make lock`, after setup.py has changed or `make setup` has brought newer packages.
# Holds for ROS 2 from wheels, and Python 3.11 or later. `LOCKED=1 make setup` installs from it.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
uv=.venv/bin/uv
[[ -x $uv ]] || { echo "lock: no .venv; run make setup" >&2; exit 1; }

draft=$(mktemp)
trap 'rm -f "$draft"' EXIT
# What is installed is preferred to what is newest; packages of this repository are not pinned.
"$uv" pip freeze --python .venv/bin/python 2>/dev/null | grep '==' >"$draft"
.venv/bin/python -c 'import setup
print(*setup.REQUIRES, "setuptools>=77", "wheel",
      *(line for extra, lines in setup.EXTRAS.items() if extra != "sourced" for line in lines),
      sep="\n")' |
  "$uv" pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-header \
    --no-annotate - --output-file "$draft" >/dev/null
{
  echo "# SPDX-License-Identifier: Apache-2.0"
  echo "# Written by make lock: what the tests ran with, for ROS 2 from wheels and Python 3.11 on."
  cat "$draft"
} >requirements.lock
echo "lock: requirements.lock pins $(grep -c '==' requirements.lock) packages"
