"""The ground floor: settings, problem details, metrics, logs, the memory budget, the context of a request."""
