"""What `roomlight dataset` prints and draws."""
