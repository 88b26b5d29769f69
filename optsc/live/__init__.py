"""Live sessions: a person drives the arm from a web page, while the control loop runs in a process of its own."""
