"""Measure speed: every figure beside something else that is measured in the same run.

Each benchmark is a command, a function that runs it and a report with a table and JSON:

    roomlight bench stages     `stages.run_stages`              the engine's stages, one by one
    roomlight bench server     `server.run_server_bench`        a server under streaming phones
    roomlight bench hostile    `hostile.run_hostile`            a neighbour beside another client's attacks
    roomlight bench composite  `composite.run_composite`        what virtual objects in a frame cost

Start with `stages`. A `BenchStage` is one row of its table: our implementation, a readable NumPy reference and a plain
PyTorch one (`plain_torch`); networks also as a share of the machine's peak. `timing` interleaves the runs, so
that other work on the machine slows all of them alike.

All benchmarks run from an installed package; none needs a checkout. PyTorch (`pip install 'roomlight[train]'`) is
optional for `stages`: without it, the comparisons with PyTorch are left out, and the networks if no weights are given.
"""
