"""What ,  and  ask and put on screen."""
