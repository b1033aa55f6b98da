"""Physics of the whole robot in a scene: wheels or rollers, arm, contacts, scanners, persons."""
