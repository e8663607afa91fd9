"""`make testbed`: the testbed of `compose.yaml` on a real Docker engine, proved and measured.

    checks -> prepare (base image, build) -> profiles (to their end) -> clients, isolation, wrong starts
           -> disturb + load + watch (what happens meanwhile) -> ledger -> table (docs/testbed.md)

No tests of pytest: one program, `python -m tests.testbed`, which brings up containers of a project of its own, and
takes them down whatever happens. `checks` needs nothing but the standard library, so that people can use it by hand.
"""
