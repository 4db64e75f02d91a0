"""Reports about datasets: contact sheets and tables of statistics."""
