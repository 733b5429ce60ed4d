# Texts of the page that teaches a job.

teach-title = Apprentissage
teach-what = Montrez la pièce une fois aux deux caméras. edged propose avec quoi mesurer, et dit à chaque geste quelle précision en résulte.
teach-no-rig = Il n’y a pas encore de calibrage : sans lui, aucune image n’a de millimètres.

## How one begins
teach-begin = Une nouvelle pièce
teach-begin-what = Posez la pièce là où elle doit être mesurée, sans rien d’autre autour.
teach-take = Prendre la paire
teach-taking = Un instant …
teach-take-cell = Prenez la cellule pour prendre une paire : ses caméras sont nécessaires.
teach-known = Tâches de cette cellule
teach-known-what = Modifiez-en une sur la paire avec laquelle elle a été apprise, ou réapprenez-la. Elle reste telle quelle jusqu’à ce que vous utilisiez la nouvelle.
teach-edit = Modifier
teach-edit-job = Modifier { $name }
teach-again = Réapprendre
teach-again-job = Réapprendre : { $name }, sur une nouvelle paire

## The draft
teach-undo = Annuler
teach-redo = Rétablir
teach-undone = Annulé.
teach-redone = Rétabli.
teach-other = Une autre pièce
teach-discard-what = La paire et tout ce qui y a été choisi seront perdus. Une tâche en service reste.
teach-changes = modifie { $job }
teach-proposing = Recherche de ce qui peut être mesuré …
teach-trouble = Rien ne peut encore être appris de cela :

## What it is worth
teach-predicted = Attendu pour cette pièce, là où elle est
teach-predicted-later = Touchez la pièce sur l’image de gauche.
teach-predicted-none = Ce qui est choisi ne donne pas de position : prenez au moins un cercle, un trou oblong ou deux bords.
teach-free = inconnu : indiscernable
teach-better = était ± { $before }
teach-worse = était ± { $before }
teach-no-rivals = Aucune autre rotation ne lui ressemble.
teach-rival = Tournée de { $angle }°, elle se ressemble à { $percent } % : prenez une caractéristique qui y diffère, sinon sa rotation peut être fausse.
teach-far-rival = Tournée de { $angle }°, elle se ressemble à { $percent } % : encore distinguée.

## The pictures
teach-tools = Ce que fait un toucher sur l’image de gauche
teach-choose = Choisir des caractéristiques
teach-now-choose = Touchez un contour, ou le milieu d’un trou : continu et coché est pris, pointillé est écarté.
teach-now-reference = Touchez le point dont les coordonnées sont publiées : edged prend le milieu de ce qui s’y trouve.
teach-now-gripping = Touchez là où la pince doit saisir.
teach-picture-left = Image de gauche. Les flèches déplacent une croix, Entrée y touche, plus et moins zooment, 0 montre tout.
teach-picture-right = Image de droite, la même partie
teach-look = Regarder
teach-look-at = Regarder { $key }
teach-place-reference = référence
teach-place-gripping = prise
teach-place-reference-said = La référence est définie.
teach-place-gripping-said = Le point de prise est défini.

## Where the part is
teach-part = Où est la pièce
teach-tool-tap = Toucher
teach-tool-rectangle = Rectangle
teach-tool-circle = Cercle
teach-tool-polygon = Polygone
teach-tool-brush = Effacer
teach-tool-tap-what = Touchez la pièce : la région s’étend jusqu’à son contour.
teach-tool-rectangle-what = Tirez d’un coin à l’autre, ou touchez les deux.
teach-tool-circle-what = Tirez du centre au bord, ou touchez les deux.
teach-tool-polygon-what = Touchez coin après coin ; de nouveau le premier le ferme.
teach-tool-brush-what = Passez sur ce qui n’est pas la pièce, par exemple une ombre ou une étiquette.
teach-cut = Découper
teach-place = En placer un au milieu
teach-close = Le fermer
teach-no-region = Rien encore : toute l’image serait apprise.
teach-adds = { $kind } { $shape }
teach-cuts = { $kind } { $shape }, découpé
teach-remove = Supprimer
teach-remove-shape = Supprimer la forme { $shape }
teach-shape-rectangle = Rectangle
teach-shape-circle = Cercle
teach-shape-polygon = Contour
teach-shape-brush = Trait effacé
teach-handle = { $kind } { $shape }, point { $point } : { $x }, { $y } px. Les flèches le déplacent.

## Features
teach-features = Caractéristiques : { $taken } prises sur { $count }
teach-features-what = edged mesure avec ce qui est pris. Écartez ce qui est flou, ou bouge sur la pièce.
teach-no-features = Elles apparaissent dès que la cellule sait où est la pièce.
teach-take-all = Tout prendre
teach-taken-said = { $key } est pris.
teach-left-said = { $key } est écarté.
teach-kind-circle = cercle
teach-kind-slot = trou oblong
teach-kind-edge = bord
teach-kind-corner = coin
teach-kind-curve = courbe
teach-size-diameter = Ø { $mm } mm
teach-size-length = longueur { $mm } mm
teach-size-width = largeur { $mm } mm
teach-why-not-seen = pas vu sur cette paire
teach-why-left-out = écarté par une personne
teach-warnings = À vérifier
teach-warning-cut = Le contour est coupé.
teach-warning-round = Elle est ronde : sa rotation est indéterminée.
teach-warning-symmetric = Tournée, elle a le même aspect.
teach-warning-confusable = Tournée, elle a presque le même aspect.
teach-warning-weak = Peu de contraste : plus de lumière, ou de côté.
teach-warning-few-points = Peu de bords : une partie plus grande ou plus nette aiderait.
teach-warning-few-levels = Petite dans l’image : des caméras plus proches aideraient.
teach-warning-lopsided = Une direction est connue bien moins bien que l’autre.
teach-warning-bright-walls = Parois aussi claires que la face : trous vus trop profonds.
teach-warning-uneven = Les bords d’une face ne sont pas de niveau.
teach-warning-one-pair = Une paire ne montre pas comment les bords sont cassés.
teach-warning-not-found = Elle n’a pas été retrouvée dans sa propre image.

## Points and sizes
teach-reference = Référence
teach-reference-what = Le point dont l’automate et le robot reçoivent les coordonnées. Proposé : celui qui est connu le mieux.
teach-reference-tap = La toucher dans l’image
teach-reference-feature = ou le milieu de
teach-gripping = Point de prise
teach-gripping-what = Où la pince saisit, si c’est ailleurs : à partir de la référence, selon les axes de la pièce.
teach-gripping-tap = Le toucher
teach-gripping-type = Le saisir
teach-gripping-none = Pas d’autre point
teach-tray = Plateau
teach-tray-what = Où des pièces sont dans des alvéoles : rangées et colonnes à pas égaux, d’après les positions indiquées pour une pièce dans les coins.
teach-tray-columns = Colonnes
teach-tray-rows = Rangées
teach-tray-tolerance = Tolérance
teach-tray-first = Première alvéole
teach-tray-row-end = Dernière alvéole de la première rangée
teach-tray-column-end = Première alvéole de la dernière rangée
teach-tray-type = Décrire un plateau
teach-tray-none = Pas de plateau
teach-sizes = Cotes à contrôler
teach-sizes-what = Mesurées sur chaque pièce. En dehors de nominal ± tolérance, la pièce n’est pas bonne.
teach-size-of = De
teach-size-to = À
teach-size-kind = Quoi
teach-size-witness = La cote qui contrôle le calibrage sur chaque pièce : toujours mesurée.
teach-size-alone = – (sa propre cote)
teach-size-add = Ajouter cette cote
teach-size-good = dans la tolérance
teach-size-bad = hors tolérance
teach-size-remove = Supprimer la cote { $name }
teach-nominal = Nominal
teach-tolerance = Tolérance ±
teach-measure-radius = rayon
teach-measure-distance = distance
teach-measure-angle = angle
teach-measure-width = largeur
teach-measure-length = longueur
teach-measure-height = hauteur
teach-measure-flatness = planéité

## Its release
teach-job = La tâche
teach-name = Nom
teach-name-wrong = Lettres, chiffres, « _ », « . » ou « - », en commençant par une lettre ou un chiffre
teach-number = Numéro dans l’automate
teach-activate = Utiliser cette tâche
teach-try = L’essayer d’abord
teach-activate-title = Utiliser { $name } ?
teach-activate-what = Elle devient une version à part. Si quelque chose échoue, l’ancienne reste ; vous pouvez y revenir dans la liste des versions.
teach-activated = { $name } est en service, version { $number }.

## What teaches nothing
problem-teach-no-feature = Il n’y a aucun cercle, trou oblong ni bord droit que les deux caméras voient. Posez la pièce devant les deux, éclairez-la, et touchez-la.
problem-teach-one-sided = Ce que montre l’image de gauche n’est pas retrouvé dans celle de droite. La pièce est-elle devant les deux caméras, sans rien entre elles ? Sinon le calibrage est celui d’autres caméras : contrôlez-le.
problem-teach-patterned-table = Autour de la pièce se trouvent les trous d’une table perforée, et la pièce elle-même ne montre que des cercles d’un même axe, qui ne disent pas la rotation. Posez-la sur une table unie pour l’apprendre, ou ajoutez son fichier STEP.
problem-teach-small-region = La sélection est vide ou minuscule : touchez la pièce, ou dessinez autour.
problem-teach-crossing = Les lignes autour de la pièce se croisent : placez les coins l’un après l’autre autour d’elle.
problem-teach-few-edges = La sélection montre trop peu de bords. La pièce y est-elle, éclairée et nette ?
problem-teach-nothing-there = Rien n’a là de contour net. Dessinez autour de la pièce, ou éclairez-la pour qu’elle se détache de la table.
problem-teach-no-pair = Cette tâche a été apprise ailleurs et ne garde pas de paire : apprenez-la sur une nouvelle.
problem-teach-nothing-left = Il ne reste rien avec quoi mesurer : prenez au moins un cercle, un trou oblong ou deux bords.
problem-teach-no-pictures = Ce cycle n’a pas d’images : les caméras n’en ont pas donné.
problem-teach-other-rig = Ce cycle a été mesuré avec un autre calibrage, et ce que ses images montrent est ailleurs à présent. Prenez-en un plus récent.
problem-teach-further-none = La paire { $pair } ne montre pas cette pièce une fois et entière dans les deux images : prenez-en une autre, ou retirez-la.
problem-teach-further-little = Toutes les paires ensemble montrent trop peu de la pièce.
problem-teach-further-needless = Cette pièce a trop peu de courbes pour apprendre d’autres paires : retirez-les.
problem-teach-further-size = Cette paire n’a pas la taille de la première.

teach-further = Autres paires
teach-further-what = Les arêtes usinées sont cassées, et une pièce posée bien en face des caméras ne montre pas comment. Inclinez-la de 10 à 40 degrés, ou éclairez-la autrement, et ajoutez cette paire.
teach-further-add = Ajouter une paire
teach-further-said = La paire est ajoutée.
teach-further-removed = La paire est retirée.
teach-further-pair = Paire { $number }
teach-further-remove-pair = Supprimer la paire { $number }
teach-further-open = La forme des arêtes cassées n’est pas établie : chaque image la donne à nouveau, et le sigma dit à quel point.
teach-further-none = Les arêtes sont vives.
teach-further-face = Arêtes cassées sur { $width } mm ; les arêtes de la face ont été apprises.
teach-further-wall = Arêtes cassées sur { $width } mm ; les arêtes de la paroi ont été apprises.
teach-further-either = Arêtes cassées sur { $width } mm ; l’une ou l’autre arête a été apprise.

## A drawing instead of the region
teach-drawing = Dessin
teach-drawing-what = La tâche peut être apprise d’un dessin DXF de la face que les caméras voient : elle a alors les cotes du dessin. La paire montre où est la pièce.
teach-drawing-is = Apprise de { $name }, sa face à { $depth } mm de la caméra gauche.
teach-drawing-back = Un toucher sur la pièce, ou une autre région, apprend de nouveau à partir de la paire.
teach-drawing-more = Unité, distance, calques
teach-drawing-unit = Unité
teach-drawing-unit-own = celle du dessin
teach-drawing-depth = Distance de la face ; vide : comme la paire la montre
teach-drawing-layers = Calques, séparés par des virgules ; vide : tous les visibles
teach-drawing-choose = Choisir un fichier DXF
teach-drawing-reading = Lecture …
teach-drawing-said = La tâche est apprise de { $name }.
problem-teach-drawing-no-dxf = Ce n’est pas un dessin DXF lisible. Exportez-le à nouveau en DXF.
problem-teach-drawing-unit = Le dessin n’indique pas son unité : choisissez-la sous « Unité, distance, calques », puis choisissez de nouveau le fichier.
problem-teach-drawing-layer = Le dessin n’a pas ce calque. Il a : { $there }
problem-teach-drawing-large = Ce n’est pas le dessin d’une seule pièce : trop de formes, de points ou d’octets. Exportez seulement sa face.
problem-teach-drawing-flat = Le dessin n’est pas plan : exportez la face en lignes dans le plan x-y.
problem-teach-drawing-empty = Il n’y a pas de contour fermé dans le dessin. Lignes, arcs, cercles et polylignes sont lus.
problem-teach-drawing-open = Un contour est ouvert : il s’arrête à x { $x }, y { $y } mm. Fermez-le, ou nommez les calques de la pièce.
problem-teach-drawing-branch = Aucun contour ne se ferme en x { $x }, y { $y } mm : il y a un embranchement, ou une ligne en double. Corrigez-la, ou nommez les calques de la pièce.
problem-teach-drawing = Le dessin n’est pas utilisable : { $detail }
problem-teach-drawing-depth = La paire ne montre pas à quelle distance est la face : indiquez sa distance à la caméra gauche.
problem-teach-drawing-unread = Le navigateur n’a pas pu lire ce fichier.
problem-teach-not-as-drawn = Rien sur cette paire ne ressemble au dessin. Est-ce la face que les caméras voient, sans inversion, dans son unité, à cette distance, et entière sur les deux images ?
