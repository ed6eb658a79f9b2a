"""Bodies and data to look at: videos and pages."""
