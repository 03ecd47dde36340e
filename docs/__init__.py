"""The pages that come with rotorsim."""
