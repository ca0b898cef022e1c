"""Launch: the plan of what is started, and running loops."""
