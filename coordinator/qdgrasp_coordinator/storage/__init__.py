"""What lies on a disk: folders of jobs and runs, their journals, and how they are written."""
