"""The commands, a module each with an `app` of one command: arguments are read before anything heavy is imported."""
