"""Reports of runs: histories, figures and tables of a campaign, and details of a row."""
