"""Concealed machines: a second program, which shares nothing with rotorsim, makes recordings to judge a diagnosis."""
