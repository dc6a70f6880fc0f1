"""The recorder: what arrives of a job, in order, into the journals of its runs."""
