"""The command `metamorph` as `python -m metamorph`. With `--protocol CLASS UNTIL` before a command it knows a protocol written in Python:
`python -m metamorph --protocol election:Leader election:agreed view run.journal`."""

import sys

from . import _embedded, _program

if sys.argv[1:2] == [_embedded.OPTION]:
    if len(sys.argv) < 5:
        sys.exit(f"{_embedded.OPTION} needs a class, `until` and a command; `-` stands for what is not given")
    _embedded.main(sys.argv[2], sys.argv[3], sys.argv[4:])
else:
    _program.main()
