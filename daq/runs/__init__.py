"""Run files: MCAP and CSV, written and read, whole or damaged."""

from daq.runs.blocks import BLOCKS, Mean, block_means, mean_interval, mean_of
from daq.runs.columns import IMU
from daq.runs.csv_run import MIN_SAMPLES, RawTable, read_csv, write_csv
from daq.runs.mcap_run import RawRun, RunWriter, read_run, recover
from daq.runs.streams import Note

__all__ = [
    "BLOCKS", "IMU", "MIN_SAMPLES", "Mean", "Note", "RawRun", "RawTable", "RunWriter", "block_means",
    "mean_interval", "mean_of", "read_csv", "read_run", "recover", "write_csv"
]
