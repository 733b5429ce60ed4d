# Texts of calibrate.js.
calibrate-title = Calibrage
calibrate-what = Tenez une mire devant les deux caméras, à différents endroits et inclinaisons. edged dit quelle vue aide le plus, et quand cela suffit.
calibrate-new = Commencer un autre calibrage
calibrate-nameless = { $id }, pas encore de mire
calibrate-begun-views =
    { $views ->
        [one] une vue
       *[other] { $views } vues
    }
calibrate-discard-what = Toutes ses vues seront perdues. Le calibrage en service reste.
calibrate-board = Mire :
calibrate-looking = Tenez la mire devant les deux caméras, là où seront les pièces, jusqu’à ce qu’elle soit reconnue.
sigma-unknown =
    { $used ->
        [0] Montrez la mire aux deux caméras.
        [one] Une vue. Le premier chiffre vient avec trois.
       *[other] { $used } vues. Le premier chiffre vient bientôt.
    }
sigma-now = un point ici : ±{ $now } µm maintenant
sigma-then = ±{ $next } avec cette vue
sigma-goal = objectif ±{ $goal }
sigma-again = calcul avec la dernière vue …
sigma-reached = atteint
sigma-on = continuez
sigma-more =
    { $count ->
        [one] encore une environ
       *[other] encore { $count } environ
    }
ghost-here = ici
ghost-share = { $percent } % à l’endroit en pointillé
seen-whole = La mire est visible en entier.
seen-clipped = Des parties de la mire sont surexposées : moins de lumière.
auto-start = Prendre les vues automatiquement
auto-stop = Ne plus prendre de vues
view-take = Prendre cette vue
sound-on = Le son est activé
sound-off = Le son est coupé
ghost-where = Vue suivante :
at-upper-left = en haut à gauche
at-upper-middle = en haut au milieu
at-upper-right = en haut à droite
at-middle-left = à gauche
at-middle-middle = au milieu
at-middle-right = à droite
at-lower-left = en bas à gauche
at-lower-middle = en bas au milieu
at-lower-right = en bas à droite
far-near = près
far-middle = à mi-distance
far-far = loin
far-any = à n’importe quelle distance
tilt-square = face à la caméra gauche
tilt-right-near = son côté droit vers les caméras
tilt-left-near = son côté gauche vers les caméras
tilt-lower-away = son côté bas au loin
tilt-upper-away = son côté haut au loin
missing-dark = Pas de mire : l’image est trop sombre.
missing-bright = Pas de mire : l’image est trop claire.
missing-not-found = Aucune mire entière n’est visible.
waits-no-board = En attente de la mire.
waits-no-board-left = La caméra gauche ne voit pas toute la mire.
waits-no-board-right = La caméra droite ne voit pas toute la mire.
waits-moving = En attente que la mire soit immobile.
waits-same = Cette vue existe déjà : amenez la mire à l’endroit en pointillé.
waits-elsewhere = Amenez la mire à l’endroit en pointillé.
waits-busy = Un instant.
waits-board-unknown = La mire n’est pas encore reconnue.
why-left-out = Écartée à la main.
why-not-found = La mire n’a pas été trouvée.
why-excluded = Elle contredit les autres vues.
views-title =
    { $count ->
        [one] Une vue
       *[other] { $count } vues
    }
view-rms = rms { $rms } px
view-new = en cours de mesure
view-heldout = retirée { $heldout } px
view-remove = Écarter
view-remove-name = Écarter la vue { $name }
view-taken = Vue { $name } prise.
view-refused = La vue { $name } n’est pas utilisable : { $why }
view-removed = La vue { $name } est écartée.
undo = Annuler
undone = Annulé.
verdict-good = Ce calibrage est bon.
verdict-usable = Ce calibrage est utilisable.
verdict-repeat = Pas encore assez bon : prenez d’autres vues, puis résolvez à nouveau.
redo = Rétablir
redone = Rétabli.
solve-title = Résolution
solve-what =
    { $used ->
        [one] Une vue est utilisée.
       *[other] { $used } vues sont utilisées.
    } Chacune est aussi retirée une fois, et prédite par les autres.
solve-start = Résoudre
solve-again = Résoudre à nouveau
solve-running = Résolution en cours
solve-cancel = Interrompre
solve-done = Résolu.
solve-failed = Pas de solution :
solve-cancelled = Interrompu. Toutes les vues sont conservées.
solved-rms = Résidu, rms
solved-heldout = Vue retirée, rms
solved-sigma = Un point du volume
solved-moved = Déplacement des points par rapport au calibrage précédent
solved-report = Rapport (nouvel onglet)
activate = Utiliser ce calibrage
activate-title = Utiliser ce calibrage ?
activate-note = Calibrage, ± { $sigma } µm
activate-what = Il devient une version à part. Si quelque chose échoue, l’ancienne reste ; vous pouvez y revenir dans la liste des versions.
activated = En service, version { $number }.
other-board = Les images montrent une autre mire que celle indiquée : { $board }. Comptez les points où se rejoignent quatre cases, pas les cases ; recommencez avec la bonne.
problem-calibration-few-views = La mire est entière sur les deux images de { $found } vues sur { $pairs } ; il en faut { $least }, et vingt sont bien.
problem-calibration-parallel = La mire est inclinée de la même façon sur toutes les vues : focale et distance ne peuvent être distinguées. Inclinez-la de 20° à 40°, chaque fois dans une autre direction.
problem-calibration-one-place = Les deux images viennent d’un même endroit : est-ce deux fois la même caméra ?
problem-calibration-swapped = Gauche et droite sont échangées : agitez une main devant la caméra gauche à l’étape « Caméras ». Des caméras montées à l’envers ont le même effet.
problem-calibration-moving = Gauche et droite montrent la mire à deux endroits : tenez-la immobile jusqu’à ce que les deux soient prises, et déclenchez les deux caméras par un seul signal.
problem-calibration-contradiction = Les vues se contredisent : la mire ou une caméra a-t-elle bougé entre les expositions ?
problem-calibration-camera-moved = Une caméra a bougé entre les vues { $before } et { $after }. Resserrez ce qui a du jeu, et reprenez les vues.
problem-calibration-undetermined = Ces vues ne déterminent pas les objectifs : inclinez la mire de 20° à 40°, chaque fois dans une autre direction, et remplissez les images.
problem-calibration-other-board = Les images montrent une autre mire ({ $seen }) que celle indiquée ({ $stated }). Comptez les points où se rejoignent quatre cases, pas les cases ; recommencez avec la bonne.
