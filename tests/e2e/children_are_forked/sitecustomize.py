"""In the PYTHONPATH of `make demo` has the programs of the demonstration forked (`tests.forked_children`).

As in other tests of it: what each would import by itself takes a second of computing.
"""

import sys

if any(word.endswith("/ua-fleet") for word in sys.orig_argv):
    from tests.forked_children import fork_beside

    fork_beside()
