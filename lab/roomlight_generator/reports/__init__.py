"""Reports about datasets: contact sheets, tables of statistics, the comparison with a path tracer."""
