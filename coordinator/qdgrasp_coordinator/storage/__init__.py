"""Folders of jobs and runs on disk, their journals, and the ways in which they are written."""
