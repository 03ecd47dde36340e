"""Results as text for a terminal: tables, findings, pages of blocks; nothing here needs matplotlib."""
