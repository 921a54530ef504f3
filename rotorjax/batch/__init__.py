"""Many independent cases on one machine or many: run, kept as they finish, gone on with after a stop."""
