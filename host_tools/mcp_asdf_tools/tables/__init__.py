"""T-tables: thresholds, files for deployment, and the firmware as a folder."""
