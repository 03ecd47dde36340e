"""Tests of the block library: every equation against an independent formula."""
