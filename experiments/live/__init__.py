"""`legid live`: the dashboard. It opens no device: a recorder of its own process does, see `daq.remote`."""
