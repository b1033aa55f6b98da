"""The parts of the node `viewer`: what it hears, and what the page has it do."""
