"""Sessions in memory: one live session and its parts, the registry of all, the quotas of one owner."""
