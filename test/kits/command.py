# SPDX-License-Identifier: Apache-2.0
"""The command line, run within the test."""

from stack_counter.cli import main


def run(capsys, *arguments):
    """Exit code, stdout and stderr's last line, which must be the only one of an error."""
    code = main([str(a) for a in arguments])
    out, err = capsys.readouterr()
    assert "Traceback" not in out + err
    assert code == 0 or err.count("\n") == 1
    return code, out, err.strip().splitlines()[-1] if err.strip() else ""
