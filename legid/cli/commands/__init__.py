"""The commands of `legid`, one module each: `COMMAND` says what it takes, `run(args)` calls the verb.

A module imports nothing heavy before `run`: `legid --help` answers at once. Faces of floors and rooms load what is
asked of them, so they may be imported at the top.
"""
