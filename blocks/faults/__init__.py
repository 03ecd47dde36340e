"""Physics that a diagram may lack: the candidates of a diagnosis, by where they enter."""
