"""Run files: MCAP and CSV, written and read, whole or damaged."""

from daq.runs.blocks import BLOCKS, Mean, block_means, mean_interval, mean_of
from daq.runs.columns import IMU, is_contract_column, missing
from daq.runs.csv_run import CLOCK_BOUND, MIN_SAMPLES, RawTable, read_csv, write_csv
from daq.runs.mcap_run import RawRun, RunWriter, attached_texts, read_run, recover
from daq.runs.streams import Note

__all__ = [
    "BLOCKS", "CLOCK_BOUND", "IMU", "MIN_SAMPLES", "Mean", "Note", "RawRun", "RawTable", "RunWriter",
    "attached_texts", "block_means", "is_contract_column", "mean_interval", "mean_of", "missing", "read_csv",
    "read_run", "recover", "write_csv"
]
