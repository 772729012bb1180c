"""The law of a position loop, input = gain x (command - angle), and faults of readings that it shows."""

from estimator.loops.corrected_readings import corrected_readings, law_checks, volts_of
from estimator.loops.law_change import LawChange, LawSize, LawSizes, changed_law, without_changes
from estimator.loops.law_check import LawCause, LawCheck, check_law
from estimator.loops.law_faults import LAW_FAULTS
from estimator.loops.law_fit import LEAST_SHARE
from estimator.loops.law_run import law_runs

__all__ = ["LAW_FAULTS", "LEAST_SHARE", "LawCause", "LawChange", "LawCheck",
           "LawSize", "LawSizes", "changed_law", "check_law", "corrected_readings",
           "law_checks", "law_runs", "volts_of", "without_changes"]
