"""Reports of runs: histories, figures and tables of a campaign, all that is known of a row."""
