"""Where the rooms meet: the servo, the modes, and the shared controller."""
