"""The command line and everything a person looks at: sheets, videos, tables."""
