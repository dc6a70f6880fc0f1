"""The recorder: writes the rows of a job, in order, into the journals of its runs."""
