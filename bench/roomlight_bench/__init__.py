"""`roomlight bench`: how fast each stage is, always as a ratio to something measured in the same run."""
