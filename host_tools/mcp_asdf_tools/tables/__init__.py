"""T-tables: thresholds, files for deployment, and tables inside built images."""
