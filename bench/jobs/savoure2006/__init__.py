"""The numerical study of Savoure, Maurine, Corbel and Krut (ICRA 2006), repeated and carried further."""
