"""Design of sensors or growth for a task: candidates, goals, search, and runs on fresh seeds."""
