"""The `roomlight` command: parses options, calls the library, prints results.

Start at `main`, which lists the commands; `commands` has one module per command. The modules beside it do their work:
`replay`, `photo` (for `light`), `stream`, `train`.
"""
