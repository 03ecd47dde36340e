"""What follows from the search: verdict, statement, unknown forces, the next experiment."""
