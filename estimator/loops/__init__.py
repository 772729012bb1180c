"""The law of a position loop, input = gain x (command - angle), and faults of readings that it shows."""

from estimator.loops.corrected_readings import corrected_readings, law_checks, volts_of
from estimator.loops.law_change import LawChange, LawSize, LawSizes, changed_law, without_changes
from estimator.loops.law_check import LawCause, LawCheck, check_law
from estimator.loops.law_faults import LAW_FAULTS, LawFault
from estimator.loops.law_fit import LEAST_SHARE, LawFit, corrected
from estimator.loops.law_run import LawRun, input_column, law_runs

__all__ = ["LAW_FAULTS", "LEAST_SHARE", "LawCause", "LawChange", "LawCheck", "LawFault", "LawFit", "LawRun",
           "LawSize", "LawSizes", "changed_law", "check_law", "corrected", "corrected_readings", "input_column",
           "law_checks", "law_runs", "volts_of", "without_changes"]
