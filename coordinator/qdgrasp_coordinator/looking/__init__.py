"""Looking: one evaluation shown again, and recorded rows evaluated again."""
