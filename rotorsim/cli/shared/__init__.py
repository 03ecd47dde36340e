"""What the verbs share: options, what is read from them, and what is printed."""
