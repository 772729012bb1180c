"""Floor 4: what a person runs: the `legid` command, experiments, refits, studies, reports."""
