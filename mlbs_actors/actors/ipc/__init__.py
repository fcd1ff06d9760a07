"""Communication between the processes of a stream on one node: pipes, shared memory, wake-ups."""
