"""What an FMU says about itself: archive, modelDescription.xml, platforms, validation."""
