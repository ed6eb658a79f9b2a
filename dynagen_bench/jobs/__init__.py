"""Many independent, resumable jobs, on local processes or on a Ray cluster."""
