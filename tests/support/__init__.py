"""What several rooms of tests share: plants that the estimator did not compute, records, devices, a browser."""
