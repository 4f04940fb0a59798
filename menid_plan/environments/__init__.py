"""Where actions are executed: simulators, programs, records, and the robot itself."""
