"""How the data was made: SAC runs, their stored behaviour policies, and the episodes these give."""
