"""One command over a folder of bags: in parallel, resumable, on this machine or a Dask cluster; one table, one page."""

from vo2_identification.batch.command import BATCH_HELP, add_batch_options, diagnose_folder, fit_folder

__all__ = ["BATCH_HELP", "add_batch_options", "diagnose_folder", "fit_folder"]
